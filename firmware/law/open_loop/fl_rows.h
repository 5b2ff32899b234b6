/* A table of rows runs two motors without sensors: the field of each turns by creep or cruise.
 *
 * Angles are whole tenths of a motor degree. A creep step is one tenth; a cruise spins up through the speeds
 * 1, 2 ... cruise_tenths a tick, goes on at the last for so many ticks, and spins down the same way. Both
 * motors of a row start together; the row ends when both have ended, then waits. Steps, ramps and clock of
 * DESI (desihub/fpoffline, hwtable.py).
 */
#ifndef FL_ROWS_H
#define FL_ROWS_H

#include "fl_math.h"

enum { FL_ROWS_MOTORS = 2 };

typedef enum fl_rows_phase {
    FL_ROWS_STILL,
    FL_ROWS_CREEP,
    FL_ROWS_UP,
    FL_ROWS_CRUISE,
    FL_ROWS_DOWN
} fl_rows_phase_t;

typedef struct fl_rows_config {
    uint32_t creep_ticks;   /* ticks of a creep step; >= 1 */
    uint32_t cruise_tenths; /* of a tick of cruise; >= 1 */
    uint32_t ramp_ticks;    /* at each speed of a ramp; >= 1 */
    uint32_t pause_ticks;   /* of a unit of pause */
} fl_rows_config_t;

typedef struct fl_row {
    int32_t steps[FL_ROWS_MOTORS]; /* signed creep steps, or ticks of cruise; |steps| < 2^20 */
    bool cruise[FL_ROWS_MOTORS];
    uint16_t pause; /* after both motors have ended */
} fl_row_t;

typedef struct fl_rows_state {
    uint32_t row;  /* the one that runs; the number of rows when the table has ended */
    uint32_t tick; /* within it */
    int32_t field_tenths[FL_ROWS_MOTORS];
} fl_rows_state_t;

typedef struct fl_rows_out {
    int32_t field_tenths[FL_ROWS_MOTORS];  /* at the end of this tick */
    fl_rows_phase_t phase[FL_ROWS_MOTORS]; /* which current the motor gets */
    bool done;                             /* nothing is left to run */
} fl_rows_out_t;

/* Ticks for which a motor of a row turns.
 * @pre 0 <= motor < FL_ROWS_MOTORS */
static inline uint32_t fl_row_motor_ticks(const fl_rows_config_t *cfg, const fl_row_t *row, int motor) {
    const int32_t steps = row->steps[motor];
    const uint32_t count = (uint32_t)(steps < 0 ? -steps : steps);
    if (count == 0) return 0;
    return row->cruise[motor] ? 2 * cfg->cruise_tenths * cfg->ramp_ticks + count : cfg->creep_ticks * count;
}

/* Ticks of a row with its pause. */
static inline uint32_t fl_row_ticks(const fl_rows_config_t *cfg, const fl_row_t *row) {
    const uint32_t a = fl_row_motor_ticks(cfg, row, 0), b = fl_row_motor_ticks(cfg, row, 1);
    return (a > b ? a : b) + cfg->pause_ticks * row->pause;
}

/* What a motor does in a tick of its row.
 * @pre 0 <= motor < FL_ROWS_MOTORS */
static inline fl_rows_phase_t fl_row_phase(const fl_rows_config_t *cfg, const fl_row_t *row, int motor,
                                           uint32_t tick) {
    const uint32_t ticks = fl_row_motor_ticks(cfg, row, motor), ramp = cfg->cruise_tenths * cfg->ramp_ticks;
    if (tick >= ticks) return FL_ROWS_STILL;
    if (!row->cruise[motor]) return FL_ROWS_CREEP;
    if (tick < ramp) return FL_ROWS_UP;
    return tick < ticks - ramp ? FL_ROWS_CRUISE : FL_ROWS_DOWN;
}

/* By how much the field of a motor turns in a tick of its row, signed tenths.
 * @pre 0 <= motor < FL_ROWS_MOTORS */
static inline int32_t fl_row_turn(const fl_rows_config_t *cfg, const fl_row_t *row, int motor,
                                  uint32_t tick) {
    const uint32_t ticks = fl_row_motor_ticks(cfg, row, motor);
    uint32_t tenths = 0;
    switch (fl_row_phase(cfg, row, motor, tick)) {
    case FL_ROWS_CREEP:
        tenths = (tick + 1) % cfg->creep_ticks == 0;
        break;
    case FL_ROWS_UP:
        tenths = tick / cfg->ramp_ticks + 1;
        break;
    case FL_ROWS_CRUISE:
        tenths = cfg->cruise_tenths;
        break;
    case FL_ROWS_DOWN:
        tenths = (ticks - 1 - tick) / cfg->ramp_ticks + 1;
        break;
    case FL_ROWS_STILL:
        break;
    }
    return row->steps[motor] < 0 ? -(int32_t)tenths : (int32_t)tenths;
}

/* The next row that takes time, from `row` on; their number when there is none. */
static inline uint32_t fl_rows_next(const fl_rows_config_t *cfg, const fl_row_t *rows, uint32_t count,
                                    uint32_t row) {
    while (row < count && fl_row_ticks(cfg, &rows[row]) == 0) ++row;
    return row;
}

/* One tick of a table of `count` rows; a table that has ended holds its fields. */
static inline fl_rows_out_t fl_rows_step(const fl_rows_config_t *cfg, fl_rows_state_t *st,
                                         const fl_row_t *rows, uint32_t count) {
    fl_rows_out_t out = {{0, 0}, {FL_ROWS_STILL, FL_ROWS_STILL}, false};
    st->row = fl_rows_next(cfg, rows, count, st->row);
    if (st->row < count) {
        const fl_row_t *row = &rows[st->row];
        for (int m = 0; m < FL_ROWS_MOTORS; ++m) {
            out.phase[m] = fl_row_phase(cfg, row, m, st->tick);
            st->field_tenths[m] = fl_add_i32(st->field_tenths[m], fl_row_turn(cfg, row, m, st->tick));
        }
        if (++st->tick >= fl_row_ticks(cfg, row)) {
            st->tick = 0;
            st->row = fl_rows_next(cfg, rows, count, st->row + 1);
        }
    }
    for (int m = 0; m < FL_ROWS_MOTORS; ++m) out.field_tenths[m] = st->field_tenths[m];
    out.done = st->row >= count;
    return out;
}

#endif
