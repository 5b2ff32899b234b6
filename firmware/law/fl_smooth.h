/* Bounds the acceleration of any command: the mean of the last 32 of its values.
 *
 * Hosts send straight lines between points, whose corners are steps of velocity. The moving mean
 * turns a step of dv into a ramp of 16 ms (dv = 2000 rpm: 13 090 rad/s^2, 46 uNm for the alpha
 * motor), lags by 7.75 ms always (so all axes stay together), leaves the straight line by at most
 * dv * 16 ms / 8 at a corner (24 motor degrees at 2000 rpm), never overshoots, and arrives exactly
 * after 16 ms: sums are integers.
 */
#ifndef FL_SMOOTH_H
#define FL_SMOOTH_H

#include "fl_math.h"

#define FL_SMOOTH_BITS 5
#define FL_SMOOTH_TICKS (1 << FL_SMOOTH_BITS)

typedef struct fl_smooth_state {
    int64_t sum_cnt;
    int32_t value_cnt; /* at the end of the tick that begins now */
    float speed_rad_s; /* of the last tick */
    uint32_t next;
    int32_t ring_cnt[FL_SMOOTH_TICKS];
} fl_smooth_state_t;

typedef struct fl_command {
    int32_t position_cnt; /* now */
    float speed_rad_s;    /* over the coming tick */
    float acceleration_rad_s2;
} fl_command_t;

/* Standing at position_cnt, as if it had been commanded for 16 ms. */
static inline void fl_smooth_reset(fl_smooth_state_t *st, int32_t position_cnt) {
    for (int i = 0; i < FL_SMOOTH_TICKS; ++i) st->ring_cnt[i] = position_cnt;
    st->sum_cnt = (int64_t)position_cnt * FL_SMOOTH_TICKS;
    st->value_cnt = position_cnt;
    st->speed_rad_s = 0.0f;
    st->next = 0;
}

/* The mean of a sum of FL_SMOOTH_TICKS values, rounded. */
static inline int32_t fl_smooth_mean(int64_t sum_cnt) {
    return (int32_t)((uint64_t)(sum_cnt + FL_SMOOTH_TICKS / 2) >> FL_SMOOTH_BITS);
}

/* The command of a tick in which the sum changes by change_cnt; value and speed: of the tick before. */
static inline fl_command_t fl_smooth_command(int32_t value_cnt, int32_t change_cnt, float speed_rad_s) {
    const float speed = (float)change_cnt * (FL_RAD_S_PER_CNT_TICK / FL_SMOOTH_TICKS);
    const fl_command_t out = {value_cnt, speed, (speed - speed_rad_s) * (float)FL_TICK_HZ};
    return out;
}

/* raw_cnt: where the unsmoothed command will be at the end of the coming tick. */
static inline fl_command_t fl_smooth_step(fl_smooth_state_t *st, int32_t raw_cnt) {
    const int32_t change = fl_sub_i32(raw_cnt, st->ring_cnt[st->next]);
    st->ring_cnt[st->next] = raw_cnt;
    st->next = (st->next + 1u) & (FL_SMOOTH_TICKS - 1u);
    st->sum_cnt += change;
    const fl_command_t out = fl_smooth_command(st->value_cnt, change, st->speed_rad_s);
    st->value_cnt = fl_smooth_mean(st->sum_cnt);
    st->speed_rad_s = out.speed_rad_s;
    return out;
}

#endif
