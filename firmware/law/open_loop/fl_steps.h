/* A stepper without a sensor: a way of microsteps in segments of equal length, and the search of its datum.
 *
 * In a segment the microsteps are spread evenly. From one to the next their number changes by `change` at
 * most; the first and the last of a way have `start` at most, with which the motor starts and stops at once.
 * So a way is a trapezoid in steps, found segment by segment. MOONS: segments of 125 ms (ukatc/fpu_driver);
 * a square profile has start = most.
 */
#ifndef FL_STEPS_H
#define FL_STEPS_H

#include "fl_math.h"

typedef struct fl_steps_config {
    uint32_t segment_ticks; /* of a segment; >= most */
    int32_t start;          /* microsteps of a segment from rest, and before rest; >= 1 */
    int32_t most;           /* of any segment; >= start, < 2^15 */
    int32_t change;         /* from one segment to the next; >= 1, < 2^15 */
    int32_t field_steps;    /* microsteps of an electrical turn: four full steps; >= 4 */
} fl_steps_config_t;

typedef struct fl_steps_state {
    int32_t position; /* microsteps from the datum, as counted; |position| < 2^30 */
    int32_t goal;     /* where the way ends; |goal| < 2^30 */
    int32_t segment;  /* signed microsteps of the segment that runs, 0: at rest */
    uint32_t tick;    /* within it */
    bool seeking;     /* ends at the edge of the switch */
    bool found;       /* the last search has met it */
    int32_t slip;     /* what was counted at the edge: microsteps lost since the last search */
} fl_steps_state_t;

typedef struct fl_steps_out {
    int32_t step;  /* of this tick: -1, 0 or 1 */
    int32_t field; /* 0 .. field_steps - 1: angle of the field in microsteps */
    bool done;     /* at rest, with nothing left to go */
} fl_steps_out_t;

/* Microsteps that a motor still goes after a segment of n before it may rest.
 * @pre n >= 0 */
static inline int32_t fl_steps_braking(const fl_steps_config_t *cfg, int32_t n) {
    if (n <= cfg->start) return 0;
    const int32_t k = (n - cfg->start + cfg->change - 1) / cfg->change; /* segments until start is reached */
    const int32_t last = fl_max_i32(n - k * cfg->change, 1);
    return (k - 1) * n - cfg->change * k * (k - 1) / 2 + last;
}

/* Microsteps of the segment after one of `before`, with `left` to go: as many as can be braked in time.
 * @pre before >= 0, left >= before's braking */
static inline int32_t fl_steps_segment(const fl_steps_config_t *cfg, int32_t before, int32_t left) {
    int32_t high = before == 0 ? cfg->start : fl_min_i32(cfg->most, before + cfg->change);
    high = fl_min_i32(high, left);
    int32_t low = before > cfg->start ? fl_max_i32(before - cfg->change, 1) : 0;
    while (low < high) { /* at most 15 halvings */
        const int32_t n = low + (high - low + 1) / 2;
        if (left - n >= fl_steps_braking(cfg, n))
            low = n;
        else
            high = n - 1;
    }
    return low;
}

/* Begins a way to a goal.
 * @pre at rest */
static inline void fl_steps_go(fl_steps_state_t *st, int32_t goal) {
    st->goal = goal;
    st->seeking = false;
}

/* Begins the search of the datum: at most `most` microsteps, signed, with the speed of a start.
 * @pre at rest */
static inline void fl_steps_seek(fl_steps_state_t *st, int32_t most) {
    st->goal = fl_add_i32(st->position, most);
    st->seeking = true;
    st->found = false;
}

/* Brings to rest: the way ends as soon as it can be braked. */
static inline void fl_steps_stop(const fl_steps_config_t *cfg, fl_steps_state_t *st) {
    const int32_t n = st->segment < 0 ? -st->segment : st->segment;
    const int32_t gone = (int32_t)((int64_t)n * st->tick / cfg->segment_ticks);
    const int32_t left = (st->tick == 0 ? 0 : n - gone) + fl_steps_braking(cfg, n);
    st->goal = fl_add_i32(st->position, st->segment < 0 ? -left : left);
}

/* At the edge of the switch: what was counted there is the slip, and the count begins anew. */
static inline void fl_steps_datum(fl_steps_state_t *st) {
    st->slip = st->position;
    st->position = st->goal = st->segment = 0;
    st->tick = 0;
    st->seeking = false;
    st->found = true;
}

/* Chooses the next segment. */
static inline void fl_steps_next(const fl_steps_config_t *cfg, fl_steps_state_t *st) {
    const int32_t way = st->goal - st->position;
    const int32_t left = way < 0 ? -way : way, before = st->segment < 0 ? -st->segment : st->segment;
    const int32_t n = st->seeking ? fl_min_i32(cfg->start, left) : fl_steps_segment(cfg, before, left);
    st->segment = way < 0 ? -n : n;
    st->tick = 0;
}

/* One tick; `at_switch`: the datum switch is closed. */
static inline fl_steps_out_t fl_steps_step(const fl_steps_config_t *cfg, fl_steps_state_t *st,
                                           bool at_switch) {
    fl_steps_out_t out = {0, 0, false};
    if (st->seeking && at_switch) fl_steps_datum(st);
    if (st->tick == 0) fl_steps_next(cfg, st);
    if (st->segment != 0) {
        const int64_t n = st->segment < 0 ? -st->segment : st->segment;
        const int64_t gone = n * st->tick / cfg->segment_ticks,
                      then = n * (st->tick + 1) / cfg->segment_ticks;
        out.step = then > gone ? (st->segment < 0 ? -1 : 1) : 0;
        st->position += out.step;
        st->tick = st->tick + 1 < cfg->segment_ticks ? st->tick + 1 : 0;
    }
    if (st->tick == 0 && st->position == st->goal) {
        st->segment = 0;
        st->seeking = false;
    }
    out.done = st->segment == 0 && st->position == st->goal;
    out.field = (st->position % cfg->field_steps + cfg->field_steps) % cfg->field_steps;
    return out;
}

#endif
