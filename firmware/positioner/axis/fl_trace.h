/* As on an oscilloscope: position and voltage of both axes while they work.
 *
 * A sample covers `decimation` ticks: the position at their start and the mean voltage over them, so that
 * the sums over samples are integrals (Kronig 2020, Eq. 12). An axis at rest is not recorded. The samples
 * lie in the memory of the trajectories: a new trajectory ends the trace.
 */
#ifndef FL_TRACE_H
#define FL_TRACE_H

#include <stdint.h>

#include "fl_path.h"
#include "fl_port.h"

enum { FL_TRACE_SAMPLES = FL_PATH_SLOTS };

typedef struct fl_trace_axis {
    uint16_t count;       /* samples recorded */
    uint16_t ticks;       /* of the sample that is being taken */
    int32_t position_cnt; /* at its start */
    float voltage_sum;
} fl_trace_axis_t;

typedef struct fl_trace {
    uint16_t decimation; /* 0: off */
    fl_trace_axis_t axis[FL_AXES];
} fl_trace_t;

typedef struct fl_trace_sample {
    int32_t position_cnt;
    int16_t voltage; /* -32767..32767 is -u_dc..u_dc */
} fl_trace_sample_t;

/* Forgets what was recorded; 0 records nothing. */
static inline void fl_trace_start(fl_trace_t *t, uint16_t decimation) {
    const fl_trace_axis_t empty = {0, 0, 0, 0.0f};
    t->decimation = decimation;
    for (int i = 0; i < FL_AXES; ++i) t->axis[i] = empty;
}

/* Stores a sample: its mean voltage, -1..1 of u_dc. The samples of an axis are the slots of its path.
 * @pre a->count < FL_TRACE_SAMPLES; no trajectory is loaded */
static inline void fl_trace_put(fl_trace_axis_t *a, fl_path_t *memory, float voltage) {
    uint16_t *slot = memory->slot[a->count++];
    slot[0] = (uint16_t)a->position_cnt;
    slot[1] = (uint16_t)((uint32_t)a->position_cnt >> 16);
    slot[2] = (uint16_t)fl_round_i32(voltage * 32767.0f);
}

/* One tick of an axis: where it was at its start, and the voltage (-1..1 of u_dc) during it. */
static inline void fl_trace_add(fl_trace_t *t, int axis, fl_path_t *memory, int32_t position_cnt,
                                float voltage) {
    fl_trace_axis_t *a = &t->axis[axis];
    if (a->count == FL_TRACE_SAMPLES) return;
    if (a->ticks == 0) {
        a->position_cnt = position_cnt;
        a->voltage_sum = 0.0f;
    }
    a->voltage_sum += voltage;
    if (++a->ticks < t->decimation) return;
    fl_trace_put(a, memory, a->voltage_sum / (float)t->decimation);
    a->ticks = 0;
}

/* A sample from the memory of an axis.
 * @pre index < count of the axis */
static inline fl_trace_sample_t fl_trace_get(const fl_path_t *memory, uint16_t index) {
    const uint16_t *slot = memory->slot[index];
    const uint32_t position = slot[0] | (uint32_t)slot[1] << 16;
    const fl_trace_sample_t out = {(int32_t)position, (int16_t)slot[2]};
    return out;
}

#endif
