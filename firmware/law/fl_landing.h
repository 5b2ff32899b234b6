/* The end of a way: the last creep towards the target, and the wait until the rotor has come along. */
#ifndef FL_LANDING_H
#define FL_LANDING_H

#include "fl_smooth.h"

/* How far the command moves in a tick of the landing: slower and slower, 64 ms times the way that is left,
 * and the slowest speed. Counts. */
static inline int32_t fl_landing_step(int32_t way_cnt, int32_t slowest_cnt) {
    return slowest_cnt + (fl_abs_i32(way_cnt) >> 7);
}

/* Ticks below 2^30: some days. */
typedef struct fl_settle_config {
    int32_t tolerance_cnt;
    uint32_t settle_ticks, timeout_ticks;
} fl_settle_config_t;

typedef struct fl_settle_state {
    uint32_t leg_ticks, calm_ticks;
    int32_t lag_cnt; /* behind the command, averaged */
} fl_settle_state_t;

/* True when the command is constant and the rotor does not lag, for the settle time; or when the time is
 * over. behind_cnt: of the rotor, in the direction of the way. It is averaged over some 4 ms against the
 * noise of the sensors. Beyond the target counts as arrived: the backlash lies between the rotor and any way
 * back. */
static inline bool fl_settle_step(const fl_settle_config_t *cfg, fl_settle_state_t *st, int32_t behind_cnt) {
    const bool begun = ++st->leg_ticks > FL_SMOOTH_TICKS; /* lag and calm ticks are 0 before */
    st->lag_cnt += begun ? (behind_cnt - st->lag_cnt) >> 3 : 0;
    st->calm_ticks = begun && st->lag_cnt <= cfg->tolerance_cnt ? st->calm_ticks + 1 : 0;
    /* one of them below zero: no branches, so that the waits of many axes fit into vectors */
    const int32_t calm_left = (int32_t)(cfg->settle_ticks - st->calm_ticks);
    const int32_t time_left = (int32_t)(cfg->timeout_ticks + FL_SMOOTH_TICKS - st->leg_ticks);
    return (calm_left | time_left) < 0;
}

#endif
