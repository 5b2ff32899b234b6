/* An observer of the tracking error e = commanded - measured angle, of its rate and of the load that the
 * feedforward does not know, in rad/s^2 (load over inertia):
 *
 *   e'' = load - (T - T_ff + c e')/J
 *
 * corrected once a tick by the error measured, then led on by the torque of the coming tick. Three equal
 * poles p of the tick: gains 1 - p^3, 1.5 (1 - p)^2 (1 + p)/dt, (1 - p)^3/dt^2.
 */
#ifndef FL_OBSERVER_H
#define FL_OBSERVER_H

#include "fl_math.h"

typedef struct fl_observer_gains {
    float e, v, a; /* 1, 1/s, 1/s^2 */
} fl_observer_gains_t;

typedef struct fl_observer_state {
    float error_rad, rate_rad_s, load_rad_s2;
} fl_observer_state_t;

/* Gains that put all three poles at `pole`.
 * @pre 0 <= pole < 1 */
static inline fl_observer_gains_t fl_observer_gains(float pole) {
    const float q = 1.0f - pole, per_s = (float)FL_TICK_HZ;
    const fl_observer_gains_t out = {1.0f - pole * pole * pole, 1.5f * q * q * (1.0f + pole) * per_s,
                                     q * q * q * (per_s * per_s)};
    return out;
}

/* By the error measured at the start of a tick. */
static inline void fl_observer_correct(const fl_observer_gains_t *gains, fl_observer_state_t *st,
                                       float error_rad) {
    const float news = error_rad - st->error_rad;
    st->error_rad += gains->e * news;
    st->rate_rad_s += gains->v * news;
    st->load_rad_s2 += gains->a * news;
}

/* To the start of the next tick; drives_rad_s2: (T - T_ff + c e')/J during this one. */
static inline void fl_observer_predict(fl_observer_state_t *st, float drives_rad_s2) {
    const float gains_rad_s = (st->load_rad_s2 - drives_rad_s2) * FL_TICK_S;
    st->error_rad += (st->rate_rad_s + 0.5f * gains_rad_s) * FL_TICK_S;
    st->rate_rad_s += gains_rad_s;
}

#endif
