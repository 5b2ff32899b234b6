/* A go-to move: trapezoidal speed between two positions, ending exactly.
 *
 * All ticks of acceleration are equal, so the distance is a * n_ramp * (n_ramp + n_cruise) and the
 * one division that finds a is done at the start; a tick costs two 64-bit additions.
 */
#ifndef FL_PROFILE_H
#define FL_PROFILE_H

#include "fl_linear.h"

#define FL_Q30 ((int64_t)1 << 30)

typedef struct fl_profile_state {
    int64_t position_q30, speed_q30, acceleration_q30; /* counts, counts/tick, counts/tick^2; 2^-30 */
    uint32_t tick, ramp_ticks, total_ticks;
    int32_t target_cnt;
} fl_profile_state_t;

typedef struct fl_profile_limits {
    float speed_cnt_tick, acceleration_cnt_tick2; /* both > 0 */
} fl_profile_limits_t;

typedef struct fl_profile_shape {
    uint32_t ramp_ticks, cruise_ticks;
} fl_profile_shape_t;

/* Whole ticks that keep both limits; at least one of ramp. */
static inline fl_profile_shape_t fl_profile_shape(uint32_t distance_cnt, fl_profile_limits_t lim) {
    const float distance = (float)distance_cnt;
    const float full_ramp = lim.speed_cnt_tick / lim.acceleration_cnt_tick2;
    fl_profile_shape_t shape = {1u + (uint32_t)full_ramp, 0};
    const float at_full_speed = distance / lim.speed_cnt_tick;
    if (at_full_speed > (float)shape.ramp_ticks) {
        shape.cruise_ticks = 1u + (uint32_t)(at_full_speed - (float)shape.ramp_ticks);
    } else {
        /* a triangle: ramp_ticks^2 >= distance / acceleration, to the rounding of a float */
        shape.ramp_ticks = 1u + (uint32_t)fl_sqrt(distance / lim.acceleration_cnt_tick2);
    }
    return shape;
}

/* Plans a move between two positions, counts; a way of zero has no ticks.
 * @pre both limits > 0 */
static inline void fl_profile_start(fl_profile_state_t *st, int32_t from_cnt, int32_t to_cnt,
                                    fl_profile_limits_t lim) {
    const int64_t way = (int64_t)to_cnt - from_cnt;
    const fl_profile_shape_t s = fl_profile_shape((uint32_t)(way < 0 ? -way : way), lim);
    st->acceleration_q30 =
        (way * FL_Q30) / ((int64_t)s.ramp_ticks * (int64_t)(s.ramp_ticks + s.cruise_ticks));
    st->position_q30 = (int64_t)from_cnt * FL_Q30;
    st->speed_q30 = st->acceleration_q30 / 2;
    st->tick = 0;
    st->ramp_ticks = s.ramp_ticks;
    st->total_ticks = way == 0 ? 0 : 2 * s.ramp_ticks + s.cruise_ticks;
    st->target_cnt = to_cnt;
}

/* Whether the target is reached. */
static inline bool fl_profile_done(const fl_profile_state_t *st) { return st->tick >= st->total_ticks; }

/* Whole counts, rounded down. */
static inline int32_t fl_profile_cnt(int64_t position_q30) { return (int32_t)((uint64_t)position_q30 >> 30); }

/* Position at the end of the next tick; the target from the last one on. */
static inline int32_t fl_profile_step(fl_profile_state_t *st) {
    if (st->tick + 1 >= st->total_ticks) {
        st->tick = st->total_ticks;
        return st->target_cnt;
    }
    st->position_q30 += st->speed_q30;
    ++st->tick;
    /* the speed in the middle of a tick: half steps where ramp and cruise meet */
    if (st->tick < st->ramp_ticks)
        st->speed_q30 += st->acceleration_q30;
    else if (st->tick == st->ramp_ticks && st->total_ticks > 2 * st->ramp_ticks)
        st->speed_q30 += st->acceleration_q30 / 2;
    else if (st->tick == st->total_ticks - st->ramp_ticks && st->total_ticks > 2 * st->ramp_ticks)
        st->speed_q30 -= st->acceleration_q30 / 2;
    else if (st->tick > st->total_ticks - st->ramp_ticks)
        st->speed_q30 -= st->acceleration_q30;
    return fl_profile_cnt(st->position_q30);
}

#endif
