/* What repeats with the rotor's turn in the load on a motor, learnt while it drives and taken off.
 *
 * Hall offsets that are known wrongly bend the measured angle once a turn, amplitudes and phase twice: at a
 * constant speed w a load J e'' that grows with w^2. Cogging (Eq. 10) that is
 * known wrongly, or not at all, is a torque of orders 2 and 4 that does not depend on the speed:
 *
 *   ripple = (w/w0)^2 (a_1 sin t + b_1 cos t + a_h sin 2t + b_h cos 2t)
 *          + a_2 sin 2t + b_2 cos 2t + a_4 sin 4t + b_4 cos 4t             t: rotor angle, w0: 2000 rpm
 *
 * Learnt by the steepest descent (LMS) of what one tick shows, J e'' + T - T_ff - ripple + c e', less its
 * mean: differences of three samples of the angle, noise of 70 uNm for alpha, but nearly none of it at these
 * orders. With a share of 1/512 a tick a coefficient is right to 1/e after 0.5 s at 2000 rpm, and scatters by
 * 0.01 (order 1) to 0.16 uNm (order 4). A touch changes it by less than 0.04 uNm before it is found, a wall
 * by less than 0.1 (tests/firmware/test_fw_ripple.py).
 */
#ifndef FL_RIPPLE_H
#define FL_RIPPLE_H

#include "fl_math.h"

#define FL_RIPPLE_PER_RAD2 2.279728e-05f /* 1/w0^2, w0 = 209.44 rad/s */
#define FL_RIPPLE_PACE_MOST 4.0f         /* (w/w0)^2: faster, it is not extrapolated */
#define FL_RIPPLE_MOST_RAD_S2 3000.0f    /* of a coefficient over the inertia: 10 uNm for alpha */
#define FL_RIPPLE_NEWS_RAD_S2 (3.0e5f)   /* of what one tick shows: 15 sigma of the noise */

/* Of order 2 at one speed nothing tells whether it is the angle's or the torque's. It is taken for the
 * angle's at first, which may be wrong by more: a weak channel. */
#define FL_RIPPLE_LATER 0.125f

typedef struct fl_ripple_state {
    float once_sin_Nm, once_cos_Nm;   /* order 1 of the angle, at w0 */
    float hall_sin_Nm, hall_cos_Nm;   /* order 2 of the angle, at w0 */
    float twice_sin_Nm, twice_cos_Nm; /* order 2 of the torque */
    float four_sin_Nm, four_cos_Nm;   /* order 4 of the torque */
    float error_rad, step_rad;        /* of the tick before: error, and its change in it */
    float beyond_Nm, sum_Nm;          /* of the tick before, and of both before */
    float sin, cos;                   /* rotor angle in the middle of the tick before */
} fl_ripple_state_t;

/* The angles of a tick and what they count. */
typedef struct fl_ripple_waves {
    float once_sin, once_cos, hall_sin, hall_cos, twice_sin, twice_cos, four_sin, four_cos;
} fl_ripple_waves_t;

/* The waves at a rotor angle and (w/w0)^2. */
static inline fl_ripple_waves_t fl_ripple_waves(float sin, float cos, float pace) {
    const float twice_sin = 2.0f * sin * cos, twice_cos = 1.0f - 2.0f * sin * sin;
    const float four_sin = 2.0f * twice_sin * twice_cos, four_cos = 1.0f - 2.0f * twice_sin * twice_sin;
    const fl_ripple_waves_t out = {pace * sin, pace * cos, pace * twice_sin, pace * twice_cos,
                                   twice_sin,  twice_cos,  four_sin,         four_cos};
    return out;
}

/* (w/w0)^2, kept within what was learnt. */
static inline float fl_ripple_pace(float speed_rad_s) {
    return fl_min(speed_rad_s * speed_rad_s * FL_RIPPLE_PER_RAD2, FL_RIPPLE_PACE_MOST);
}

/* The ripple where the waves are, Nm, positive as a load that e'' shows. */
static inline float fl_ripple_torque(const fl_ripple_state_t *st, const fl_ripple_waves_t *at) {
    return st->once_sin_Nm * at->once_sin + st->once_cos_Nm * at->once_cos + st->hall_sin_Nm * at->hall_sin +
           st->hall_cos_Nm * at->hall_cos + st->twice_sin_Nm * at->twice_sin +
           st->twice_cos_Nm * at->twice_cos + st->four_sin_Nm * at->four_sin + st->four_cos_Nm * at->four_cos;
}

/* Takes in a step of `news`; a coefficient stays within +-most, and is a number whatever comes. */
static inline void fl_ripple_adapt(fl_ripple_state_t *st, const fl_ripple_waves_t *at, float news_Nm,
                                   float most_Nm) {
    st->once_sin_Nm = fl_clamp(st->once_sin_Nm + news_Nm * at->once_sin, -most_Nm, most_Nm);
    st->once_cos_Nm = fl_clamp(st->once_cos_Nm + news_Nm * at->once_cos, -most_Nm, most_Nm);
    st->hall_sin_Nm = fl_clamp(st->hall_sin_Nm + news_Nm * at->hall_sin, -most_Nm, most_Nm);
    st->hall_cos_Nm = fl_clamp(st->hall_cos_Nm + news_Nm * at->hall_cos, -most_Nm, most_Nm);
    const float later_Nm = FL_RIPPLE_LATER * news_Nm;
    st->twice_sin_Nm = fl_clamp(st->twice_sin_Nm + later_Nm * at->twice_sin, -most_Nm, most_Nm);
    st->twice_cos_Nm = fl_clamp(st->twice_cos_Nm + later_Nm * at->twice_cos, -most_Nm, most_Nm);
    st->four_sin_Nm = fl_clamp(st->four_sin_Nm + news_Nm * at->four_sin, -most_Nm, most_Nm);
    st->four_cos_Nm = fl_clamp(st->four_cos_Nm + news_Nm * at->four_cos, -most_Nm, most_Nm);
}

typedef struct fl_ripple_in {
    float error_rad;   /* commanded minus measured motor angle, at the start of this tick */
    float beyond_Nm;   /* torque applied minus feedforward, in this tick */
    float drag;        /* Nm s/rad */
    float inertia;     /* kg m^2 */
    float speed_rad_s; /* commanded */
    float sin, cos;    /* of the rotor, measured at the start of this tick */
} fl_ripple_in_t;

/* What the tick before showed of the load, signed as the error is, less the ripple as known then. */
static inline float fl_ripple_news_Nm(const fl_ripple_state_t *st, const fl_ripple_in_t *in) {
    const float step_rad = in->error_rad - st->error_rad, per_s = (float)FL_TICK_HZ;
    return in->inertia * (per_s * per_s) * (step_rad - st->step_rad) + 0.5f * st->sum_Nm +
           in->drag * (0.5f * per_s) * (step_rad + st->step_rad);
}

/* One tick: the ripple of it, Nm. `known_Nm`: the load expected, signed as the error is. `share`: of the
 * news that is learnt; 0: none.
 * @pre in->inertia > 0; the last call was a tick ago where share > 0; share max((w/w0)^4, 1) < 1/2 */
static inline float fl_ripple_step(fl_ripple_state_t *st, const fl_ripple_in_t *in, float known_Nm,
                                   float share) {
    const float pace = fl_ripple_pace(in->speed_rad_s);
    const float most_Nm = in->inertia * FL_RIPPLE_NEWS_RAD_S2;
    const float news_Nm = fl_clamp(fl_ripple_news_Nm(st, in) - known_Nm, -most_Nm, most_Nm);
    const fl_ripple_waves_t before = fl_ripple_waves(st->sin, st->cos, pace);
    fl_ripple_adapt(st, &before, share * news_Nm, in->inertia * FL_RIPPLE_MOST_RAD_S2);

    const float half_rad = in->speed_rad_s * (0.5f * FL_TICK_S);
    st->sin = in->sin + half_rad * in->cos;
    st->cos = in->cos - half_rad * in->sin;
    const fl_ripple_waves_t now = fl_ripple_waves(st->sin, st->cos, pace);
    const float ripple_Nm = fl_ripple_torque(st, &now);
    st->step_rad = in->error_rad - st->error_rad;
    st->error_rad = in->error_rad;
    const float beyond_Nm = in->beyond_Nm - ripple_Nm;
    st->sum_Nm = beyond_Nm + st->beyond_Nm;
    st->beyond_Nm = beyond_Nm;
    return ripple_Nm;
}

#endif
