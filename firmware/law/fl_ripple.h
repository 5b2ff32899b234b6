/* What repeats with the rotor's turn in the load on a motor, learnt while it drives and taken off.
 *
 * Hall offsets that are known wrongly bend the measured angle once a turn, amplitudes and phase twice: at a
 * constant speed w a load J e'' that grows with w^2. Cogging (Eq. 10) that is known wrongly is a torque of
 * order 2 too. At full speed nothing tells them apart; below it the sensors' part, which may be larger, is
 * taken:
 *
 *   ripple = (w/w0)^2 (a_1 sin t + b_1 cos t + a_2 sin 2t + b_2 cos 2t)     t: rotor angle, w0: 2000 rpm
 *
 * Learnt by the steepest descent (LMS) of what one tick shows, J e'' + T - T_ff - ripple + c e', less its
 * mean: differences of three samples of the angle, noise of 70 uNm for alpha, but nearly none of it at these
 * orders. With a share of 1/512 a tick a coefficient is right to 1/e after 0.5 s at 2000 rpm, and scatters by
 * 0.01 (order 1) to 0.04 uNm (order 2). A touch changes it by less than 0.04 uNm before it is found, a wall
 * by less than 0.1 (tests/firmware/test_fw_touch.py). Higher orders are of no matter: the observer of
 * fl_touch.h passes 4 % of order 4 at 2000 rpm.
 */
#ifndef FL_RIPPLE_H
#define FL_RIPPLE_H

#include "fl_math.h"

#define FL_RIPPLE_PER_RAD2 2.279728e-05f /* 1/w0^2, w0 = 209.44 rad/s */
#define FL_RIPPLE_PACE_MOST 4.0f         /* (w/w0)^2: faster, it is not extrapolated */
#define FL_RIPPLE_MOST_RAD_S2 3000.0f    /* the root of its squares over the inertia: 10 uNm for alpha */
#define FL_RIPPLE_NEWS_RAD_S2 3.0e5f     /* more is no news of a tick: 15 sigma of the noise */

typedef struct fl_ripple_state {
    float once_sin_Nm, once_cos_Nm;   /* order 1, at w0 */
    float twice_sin_Nm, twice_cos_Nm; /* order 2, at w0 */
    float error_rad, step_rad;        /* of the tick before: error, and its change in it */
    float beyond_Nm, sum_Nm;          /* of the tick before, and of both before */
    /* of the rotor angle in the middle of the tick before, and of its double */
    float sin, cos, twice_sin, twice_cos;
} fl_ripple_state_t;

typedef struct fl_ripple_in {
    float error_rad;   /* commanded minus measured motor angle, at the start of this tick */
    float beyond_Nm;   /* torque applied minus feedforward, in this tick */
    float drag;        /* Nm s/rad */
    float inertia;     /* kg m^2 */
    float speed_rad_s; /* commanded */
    float sin, cos;    /* of the rotor, measured at the start of this tick */
} fl_ripple_in_t;

/* The rotor half a tick on, and the ripple at w0 there, Nm: a load that e'' shows. */
static inline float fl_ripple_torque(fl_ripple_state_t *st, const fl_ripple_in_t *in) {
    const float half_rad = in->speed_rad_s * (0.5f * FL_TICK_S);
    st->sin = in->sin + half_rad * in->cos;
    st->cos = in->cos - half_rad * in->sin;
    st->twice_sin = 2.0f * st->sin * st->cos;
    st->twice_cos = 1.0f - 2.0f * st->sin * st->sin;
    return st->once_sin_Nm * st->sin + st->once_cos_Nm * st->cos + st->twice_sin_Nm * st->twice_sin +
           st->twice_cos_Nm * st->twice_cos;
}

/* What the tick before showed of the load, signed as the error is, less the ripple as known then. */
static inline float fl_ripple_news_Nm(const fl_ripple_state_t *st, const fl_ripple_in_t *in) {
    const float step_rad = in->error_rad - st->error_rad, per_s = (float)FL_TICK_HZ;
    return in->inertia * (per_s * per_s) * (step_rad - st->step_rad) + 0.5f * st->sum_Nm +
           in->drag * (0.5f * per_s) * (step_rad + st->step_rad);
}

/* Takes in a share of what the tick before showed beyond `known_Nm`, a load signed as the error is.
 * @pre before fl_ripple_step of this tick; the last one was a tick ago; in->inertia > 0; share < 1/4 */
static inline void fl_ripple_learn(fl_ripple_state_t *st, const fl_ripple_in_t *in, float known_Nm,
                                   float share) {
    const float news_Nm = fl_ripple_news_Nm(st, in) - known_Nm, taken_Nm = share * news_Nm;
    const float once_sin_Nm = st->once_sin_Nm + taken_Nm * st->sin;
    const float once_cos_Nm = st->once_cos_Nm + taken_Nm * st->cos;
    const float twice_sin_Nm = st->twice_sin_Nm + taken_Nm * st->twice_sin;
    const float twice_cos_Nm = st->twice_cos_Nm + taken_Nm * st->twice_cos;
    const float square = once_sin_Nm * once_sin_Nm + once_cos_Nm * once_cos_Nm + twice_sin_Nm * twice_sin_Nm +
                         twice_cos_Nm * twice_cos_Nm;
    const float most_Nm = in->inertia * FL_RIPPLE_MOST_RAD_S2;
    /* both signs in one comparison: no branch, so that a host can do this for many axes at once */
    const float wild_Nm = fl_abs(news_Nm) - in->inertia * FL_RIPPLE_NEWS_RAD_S2;
    const bool sane = fl_max(wild_Nm, square - most_Nm * most_Nm) < 0.0f;
    st->once_sin_Nm = sane ? once_sin_Nm : st->once_sin_Nm;
    st->once_cos_Nm = sane ? once_cos_Nm : st->once_cos_Nm;
    st->twice_sin_Nm = sane ? twice_sin_Nm : st->twice_sin_Nm;
    st->twice_cos_Nm = sane ? twice_cos_Nm : st->twice_cos_Nm;
}

/* One tick: the ripple of it, Nm, a load signed as the error is. */
static inline float fl_ripple_step(fl_ripple_state_t *st, const fl_ripple_in_t *in) {
    const float pace = fl_min(in->speed_rad_s * in->speed_rad_s * FL_RIPPLE_PER_RAD2, FL_RIPPLE_PACE_MOST);
    const float ripple_Nm = pace * fl_ripple_torque(st, in), beyond_Nm = in->beyond_Nm - ripple_Nm;
    st->step_rad = in->error_rad - st->error_rad;
    st->error_rad = in->error_rad;
    st->sum_Nm = beyond_Nm + st->beyond_Nm;
    st->beyond_Nm = beyond_Nm;
    return ripple_Nm;
}

#endif
