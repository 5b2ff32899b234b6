/* A touch of the arm, found by the load on the motor before the feedback has answered it.
 *
 * What is in the way of an arm winds up its gear: at the motor the load grows by k w/n^2 (Eq. 5a, 9), for
 * alpha at 2000 rpm by 3.9e-3 Nm/s against a wall and a tenth of it against another arm. An observer of the
 * tracking error e = commanded - measured angle finds the load L beyond the feedforward:
 *
 *   J e'' = L - (T - T_ff) - c e'              T: torque asked for, T_ff: Eq. 21 with the drag as identified
 *
 * with three equal poles at 450 rad/s, corrected once a tick: white noise of the sensors is no more than
 * 0.3 uNm for alpha, a load that grows is seen 3/450 s = 6.7 ms late. What the model is wrong by
 * changes slowly at constant speed: the mean of some 60 ms, which a touch exceeds. A change of
 * speed changes it by what the drag, not yet learnt, and the inertia may be wrong by:
 *
 *   touch if sgn(w) L - mean - excess > touch + 3 doubt c | |w| - mean |w| | + 0.12 J |dw/dt|
 *
 * A unit that scatters more than others (a weak hall channel, a rough gear) is allowed 3.5 times its own
 * mean |rise| where that is more than touch.
 *
 * excess: the learnt change of the drag times the same difference of speeds. Only on the resisting side, and
 * only where the motor drives the gear: after FL_TOUCH_WAY_RAD of way one way, more than any backlash, not
 * slower than FL_TOUCH_SLOW_RAD_S.
 */
#ifndef FL_TOUCH_H
#define FL_TOUCH_H

#include "fl_observer.h"

/* 1 - p^3, 1.5 (1 - p)^2 (1 + p)/dt, (1 - p)^3/dt^2 with p = exp(-450/2000) */
#define FL_TOUCH_GAIN_E 0.490843f
#define FL_TOUCH_GAIN_V 219.0362f /* 1/s */
#define FL_TOUCH_GAIN_A 32717.51f /* 1/s^2 */
#define FL_TOUCH_LAG 0.201484f    /* 1 - p */
#define FL_TOUCH_WAY_RAD 16.0f    /* 920 motor degrees: the largest backlash, 250, and what follows its end */
#define FL_TOUCH_SLOW_RAD_S 50.0f /* slower, contacts are gentle and cogging is not */
/* from here on the observer smoothes cogging; twice the threshold at none */
#define FL_TOUCH_FAST_RAD_S 160.0f
#define FL_TOUCH_MEAN (1.0f / 120.0f)    /* per tick: 60 ms */
#define FL_TOUCH_CATCH 0.1f              /* the same while nothing is watched: 5 ms */
#define FL_TOUCH_CALM 0.98f              /* from the one to the other: 25 ms */
#define FL_TOUCH_FADE 0.97f              /* of a surge per tick: 16 ms, for the observer is late */
#define FL_TOUCH_SCATTER (1.0f / 500.0f) /* per tick: 250 ms */
#define FL_TOUCH_WILD 3.5f               /* times the scatter: a worn sensor or a rough gear is no touch */
/* at power-up, over the threshold: learnt in half a second of driving */
#define FL_TOUCH_SCATTER_FIRST 3.0f
#define FL_TOUCH_DOUBT 3.0f    /* times the doubt: what Coulomb friction is wrong by is learnt as drag */
#define FL_TOUCH_INERTIA 0.12f /* what it may be wrong by */

/* Gains, shares and fades above are those of this period. */
#if FL_TICK_HZ != 2000
#error "the gains of fl_touch.h are those of a tick of 0.5 ms"
#endif

typedef struct fl_touch_config {
    float inertia, inertia_inverse; /* kg m^2 */
    float drag;                     /* Nm s/rad */
    float threshold_Nm;
} fl_touch_config_t;

typedef struct fl_touch_state {
    float error_rad, rate_rad_s, load_rad_s2;       /* the observer: load over inertia */
    float mean_Nm, mean_speed_rad_s, follow;        /* follow: share of the news that a mean takes in */
    float late_1_rad_s, late_2_rad_s, late_3_rad_s; /* speed, as late as the load: three poles */
    float surge_rad_s2;                             /* largest acceleration lately */
    float scatter_Nm; /* mean of |rise| where it was watched: kept from move to move */
    float unrest_Nm;  /* largest change of the load lately, before it was watched */
    float way_rad;    /* driven one way */
    float rise_Nm;    /* load beyond what was expected, and what is allowed; for logs */
    float limit_Nm;
} fl_touch_state_t;

typedef struct fl_touch_in {
    float error_rad;              /* commanded minus measured motor angle */
    float beyond_Nm;              /* torque applied minus feedforward with the drag as identified */
    float excess_Nms;             /* learnt drag minus drag as identified */
    float speed_rad_s, direction; /* commanded */
    float acceleration_rad_s2;
    float drag_doubt; /* share of the drag that may not have been learnt yet */
} fl_touch_in_t;

/* The load resisting the motion, Nm: corrected by the error of now, led on by the torque of the coming tick.
 */
static inline float fl_touch_observe(const fl_touch_config_t *cfg, fl_touch_state_t *st,
                                     const fl_touch_in_t *in) {
    const fl_observer_gains_t gains = {FL_TOUCH_GAIN_E, FL_TOUCH_GAIN_V, FL_TOUCH_GAIN_A};
    fl_observer_state_t seen = {st->error_rad, st->rate_rad_s, st->load_rad_s2};
    fl_observer_correct(&gains, &seen, in->error_rad);
    fl_observer_predict(&seen, (in->beyond_Nm + (cfg->drag + in->excess_Nms) * seen.rate_rad_s) *
                                   cfg->inertia_inverse);
    st->error_rad = seen.error_rad;
    st->rate_rad_s = seen.rate_rad_s;
    st->load_rad_s2 = seen.load_rad_s2;
    return st->load_rad_s2 * cfg->inertia * in->direction;
}

/* The speed with the lag that the observer gives to the load. */
static inline float fl_touch_late(fl_touch_state_t *st, float speed_rad_s) {
    st->late_1_rad_s += FL_TOUCH_LAG * (speed_rad_s - st->late_1_rad_s);
    st->late_2_rad_s += FL_TOUCH_LAG * (st->late_1_rad_s - st->late_2_rad_s);
    st->late_3_rad_s += FL_TOUCH_LAG * (st->late_2_rad_s - st->late_3_rad_s);
    return st->late_3_rad_s;
}

/* One tick of FL_TICK_S: true when the arm is touched. rise_Nm and limit_Nm in `st` tell by how much, for
 * logs.
 * @pre in->direction is -1, 0 or 1; cfg->inertia > 0 */
static inline bool fl_touch_step(const fl_touch_config_t *cfg, fl_touch_state_t *st,
                                 const fl_touch_in_t *in) {
    const float load_Nm = fl_touch_observe(cfg, st, in);
    const float speed = fl_abs(in->speed_rad_s);
    /* the direction is the last commanded one: where it turns, so does the speed */
    const bool drives = speed >= FL_TOUCH_SLOW_RAD_S && in->direction * st->way_rad >= 0.0f;
    st->way_rad = drives ? st->way_rad + in->speed_rad_s * FL_TICK_S : 0.0f;
    const bool watched = fl_abs(st->way_rad) > FL_TOUCH_WAY_RAD;
    st->surge_rad_s2 = fl_max(fl_abs(in->acceleration_rad_s2), FL_TOUCH_FADE * st->surge_rad_s2);

    const float faster = fl_touch_late(st, speed) - st->mean_speed_rad_s, more_Nm = load_Nm - st->mean_Nm;
    st->rise_Nm = more_Nm - in->excess_Nms * faster;
    const float unrest_Nm = watched ? 0.0f : fl_abs(more_Nm);
    st->unrest_Nm = fl_max(unrest_Nm, FL_TOUCH_FADE * st->unrest_Nm);
    const float coarse = fl_max(1.0f, 2.0f - speed * (1.0f / FL_TOUCH_FAST_RAD_S));
    st->limit_Nm = fl_max(cfg->threshold_Nm * coarse, FL_TOUCH_WILD * st->scatter_Nm) + st->unrest_Nm +
                   FL_TOUCH_DOUBT * in->drag_doubt * cfg->drag * fl_abs(faster) +
                   FL_TOUCH_INERTIA * cfg->inertia * st->surge_rad_s2;
    st->follow = watched ? fl_max(FL_TOUCH_MEAN, FL_TOUCH_CALM * st->follow) : FL_TOUCH_CATCH;
    if (watched) st->scatter_Nm += FL_TOUCH_SCATTER * (fl_abs(st->rise_Nm) - st->scatter_Nm);
    st->mean_Nm += st->follow * more_Nm;
    st->mean_speed_rad_s += st->follow * faster;
    return watched && st->rise_Nm > st->limit_Nm;
}

#endif
