/* A touch of the arm, found by the load on the motor before the feedback has answered it.
 *
 * What is in the way of an arm winds up its gear: at the motor the load grows by k w/n^2 (Eq. 5a, 9), for
 * alpha at 2000 rpm by 3.9e-3 Nm/s against a wall and a tenth of it against another arm. An observer of the
 * tracking error e = commanded - measured angle finds the load L beyond the feedforward:
 *
 *   J e'' = L - (T - T_ff) - ripple - c e'     T: torque asked for, T_ff: Eq. 21 with the drag as identified
 *
 * with three equal poles at 300 rad/s, placed with the drag in the model and corrected once a tick: white
 * noise of the sensors is 0.12 uNm rms for alpha, a load that grows is seen 3/300 s = 10 ms late. What
 * repeats with the rotor's turn is learnt and taken off (fl_ripple.h). What else the model is wrong by
 * changes slowly at constant speed: the mean of some 60 ms, which a touch exceeds. A change of speed changes
 * it by what the drag, not yet learnt, and the inertia may be wrong by:
 *
 *   touch if sgn(w) L - mean - excess > touch (1 + 5 max(0, 1 - |w|/w0)) + unrest
 *                                       + 3 doubt c | |w| - mean |w| | + 0.12 J |dw/dt|
 *
 * A unit that scatters more than others (a weak hall channel, a rough gear) is allowed 8.5 times its own
 * mean |rise| where that is more than touch, 6.8 sigma of what is normally distributed, and 1.5 times the
 * deepest dip of the last 250 ms: what repeats goes both ways. Until it is learnt it is allowed 25 times
 * touch at w0, and less with (w/w0)^2 where it is slower.
 *
 * excess: the learnt change of the drag times the same difference of speeds. Only on the resisting side, and
 * only where the motor drives the gear: 20 ms after the teeth met, where the law knows that (fl_teeth.h),
 * else after FL_TOUCH_WAY_RAD of way one way, more than any backlash. Not slower than FL_TOUCH_SLOW_RAD_S.
 */
#ifndef FL_TOUCH_H
#define FL_TOUCH_H

#include "fl_observer.h"
#include "fl_ripple.h"

#define FL_TOUCH_LAG 0.139292f /* 1 - p, p = exp(-300/2000) */
#define FL_TOUCH_WAY_RAD 16.0f /* 920 motor degrees: the largest backlash, 250, and what follows its end */
/* 40 ticks since the teeth met: of a gap thought 5 motor degrees too small the observer has forgotten all but
 * a tenth, for which there is the unrest */
#define FL_TOUCH_MET_S 0.01975f
#define FL_TOUCH_SLOW_RAD_S 50.0f     /* slower, contacts are gentle and cogging is not */
#define FL_TOUCH_FAST_RAD_S 209.44f   /* w0: from here on the threshold itself */
#define FL_TOUCH_COARSE 5.0f          /* times it more at standstill: the ripple is learnt at speed */
#define FL_TOUCH_MEAN (1.0f / 120.0f) /* per tick: 60 ms */
#define FL_TOUCH_CATCH 0.1f           /* the same while nothing is watched: 5 ms */
#define FL_TOUCH_CALM 0.98f           /* from the one to the other: 25 ms */
#define FL_TOUCH_FADE 0.97f           /* of a surge per tick: 16 ms, for the observer is late */
#define FL_TOUCH_REST 0.985f          /* of the unrest: 33 ms, the feedback of Eq. 21 takes so long */
#define FL_TOUCH_DIPS 1.5f            /* times the deepest dip of late is no touch */
#define FL_TOUCH_DIP_FADE 0.998f      /* per tick: 250 ms, two motor turns at 500 rpm */
/* of the news of a tick that scatter and ripple take in, first and at last: 16 to 256 ms */
#define FL_TOUCH_SHARE_FIRST (1.0f / 32.0f)
#define FL_TOUCH_SHARE (1.0f / 512.0f)
#define FL_TOUCH_SETTLING 0.99f     /* from the one to the other, per tick of FL_TOUCH_LEARN_RAD_S: 50 ms */
#define FL_TOUCH_LEARN_RAD_S 180.0f /* slower, sensors scatter less: errors of the angle grow with w^2 */
#define FL_TOUCH_WILD 8.5f          /* times the scatter: a worn sensor or a rough gear is no touch */
#define FL_TOUCH_SCATTER_FIRST 3.0f /* at power-up, over the threshold */
#define FL_TOUCH_HALF 0.5f          /* of the limit: what rises higher may be a touch and is not learnt */
#define FL_TOUCH_STILL 2.0f         /* times the threshold: with more allowed than that nothing is learnt */
#define FL_TOUCH_DOUBT 3.0f         /* times the doubt: what Coulomb friction is wrong by is learnt as drag */
#define FL_TOUCH_INERTIA 0.12f      /* what it may be wrong by */

/* Gains, shares and fades above are those of this period. */
#if FL_TICK_HZ != 2000
#error "the gains of fl_touch.h are those of a tick of 0.5 ms"
#endif

typedef struct fl_touch_config {
    float inertia, inertia_inverse; /* kg m^2 */
    float drag;                     /* Nm s/rad */
    float gain_e, gain_v, gain_a;   /* of the observer: fl_touch_gains */
    float doubt_Nms, surge_kg_m2;   /* FL_TOUCH_DOUBT and FL_TOUCH_INERTIA of drag and inertia */
    float threshold_Nm;
} fl_touch_config_t;

typedef struct fl_touch_state {
    float error_rad, rate_rad_s, load_rad_s2;       /* the observer: load over inertia */
    float mean_Nm, mean_speed_rad_s, follow;        /* follow: share of the news that a mean takes in */
    float late_1_rad_s, late_2_rad_s, late_3_rad_s; /* speed, as late as the load: three poles */
    float surge_rad_s2;                             /* largest acceleration lately */
    float scatter_Nm; /* mean of |rise| where it was watched: kept from move to move */
    float dip_Nm;    /* how far the load fell below its mean lately: what repeats goes both ways, a touch does
                        not */
    float calm;      /* the share of the ripple's news: 0 where something may be met or much else changes */
    float share;     /* of the news that scatter and ripple take in: smaller the longer it has driven */
    float unrest_Nm; /* largest change of the load lately, before it was watched */
    float way_rad;   /* driven one way */
    float closed_s;  /* since the teeth met, where the law knows it */
    float sure;      /* 1 once the motor has driven so far one way that the teeth have met: 0 at power-up */
    float rise_Nm;   /* load beyond what was expected, and what is allowed; for logs */
    float limit_Nm;
    fl_ripple_state_t ripple; /* kept from move to move */
} fl_touch_state_t;

typedef struct fl_touch_in {
    float error_rad;              /* commanded minus measured motor angle */
    float beyond_Nm;              /* torque applied minus feedforward with the drag as identified */
    float excess_Nms;             /* learnt drag minus drag as identified */
    float speed_rad_s, direction; /* commanded */
    float acceleration_rad_s2;
    float drag_doubt; /* share of the drag that may not have been learnt yet */
    float touching;   /* 1 where the law knows that the motor pushes the gear, else 0 */
    float sin, cos;   /* of the rotor, measured */
} fl_touch_in_t;

/* Gains that put all three poles at p on a motor that drags, of which c/J is kept below 1/(4 dt). Those of
 * fl_observer.h are for a motor without drag, and would see a load 3 c/(J p^2) later: 8 ms. */
static inline fl_observer_gains_t fl_touch_gains(float damping_per_s) {
    const float q = FL_TOUCH_LAG, per_s = (float)FL_TICK_HZ;
    const float k = fl_clamp(damping_per_s * FL_TICK_S, 0.0f, 0.25f);
    /* (w + q)^3 = w^3 + (m_e + k) w^2 + (k m_e + (1 - k/2) m_v + m_a/2) w + m_a, w = z - 1, m: of the next
     * tick */
    const float m_e = 3.0f * q - k, m_a = q * q * q;
    const float m_v = (3.0f * q * q - k * m_e - 0.5f * m_a) / (1.0f - 0.5f * k);
    const float gain_v = (m_v - m_a) / (1.0f - k);
    const fl_observer_gains_t out = {m_e - (1.0f - 0.5f * k) * gain_v - 0.5f * m_a, gain_v * per_s,
                                     m_a * (per_s * per_s)};
    return out;
}

/* The load resisting the motion, Nm: corrected by the error of now, led on by the torque of the coming tick.
 * The observer keeps the drag that its gains are for: what was learnt of it since, times the rate of the
 * error, is small, and as noisy as that rate. */
static inline float fl_touch_observe(const fl_touch_config_t *cfg, fl_touch_state_t *st,
                                     const fl_touch_in_t *in, float ripple_Nm) {
    const fl_observer_gains_t gains = {cfg->gain_e, cfg->gain_v, cfg->gain_a};
    fl_observer_state_t seen = {st->error_rad, st->rate_rad_s, st->load_rad_s2};
    fl_observer_correct(&gains, &seen, in->error_rad);
    fl_observer_predict(&seen,
                        (in->beyond_Nm - ripple_Nm + cfg->drag * seen.rate_rad_s) * cfg->inertia_inverse);
    st->error_rad = seen.error_rad;
    st->rate_rad_s = seen.rate_rad_s;
    st->load_rad_s2 = seen.load_rad_s2;
    return st->load_rad_s2 * cfg->inertia * in->direction;
}

/* The speed with the lag that the observer gives to the load. */
static inline float fl_touch_late(fl_touch_state_t *st, float speed_rad_s) {
    st->late_1_rad_s = fl_follow(st->late_1_rad_s, speed_rad_s, FL_TOUCH_LAG);
    st->late_2_rad_s = fl_follow(st->late_2_rad_s, st->late_1_rad_s, FL_TOUCH_LAG);
    st->late_3_rad_s = fl_follow(st->late_3_rad_s, st->late_2_rad_s, FL_TOUCH_LAG);
    return st->late_3_rad_s;
}

/* Whether the motor drives the gear for long enough: moves the ways on by this tick. */
static inline bool fl_touch_watches(fl_touch_state_t *st, const fl_touch_in_t *in) {
    const float speed = fl_abs(in->speed_rad_s);
    /* the direction is the last commanded one: where it turns, so does the speed */
    const bool drives = FL_BOTH_REACH(speed, FL_TOUCH_SLOW_RAD_S, in->direction * st->way_rad, 0.0f);
    st->way_rad = drives ? st->way_rad + in->speed_rad_s * FL_TICK_S : 0.0f;
    st->closed_s = drives ? in->touching * (st->closed_s + FL_TICK_S) : 0.0f;
    const float way_rad = fl_abs(st->way_rad);
    st->sure = way_rad > FL_TOUCH_WAY_RAD ? 1.0f : st->sure;
    return FL_EITHER_ABOVE(way_rad, FL_TOUCH_WAY_RAD, st->sure * st->closed_s, FL_TOUCH_MET_S);
}

/* What of the load repeats with the rotor's turn, Nm: learnt where it is watched and nothing is met.
 * This and what follows is inlined, as fl_drive_end is: 40 instructions a tick and axis less. */
static inline __attribute__((always_inline)) float
fl_touch_ripple(const fl_touch_config_t *cfg, fl_touch_state_t *st, const fl_touch_in_t *in) {
    const fl_ripple_in_t now = {in->error_rad, in->beyond_Nm,   cfg->drag + in->excess_Nms,
                                cfg->inertia,  in->speed_rad_s, in->sin,
                                in->cos};
    if (st->calm > 0.0f) {
        const float faster = fl_abs(in->speed_rad_s) - st->mean_speed_rad_s;
        const float known_Nm = (st->mean_Nm + in->excess_Nms * faster) * in->direction;
        fl_ripple_learn(&st->ripple, &now, known_Nm, st->calm);
    }
    return fl_ripple_step(&st->ripple, &now);
}

/* One tick of FL_TICK_S: true when the arm is touched. rise_Nm and limit_Nm in `st` tell by how much, for
 * logs.
 * @pre in->direction is -1, 0 or 1; cfg->inertia > 0 */
static inline __attribute__((always_inline)) bool
fl_touch_step(const fl_touch_config_t *cfg, fl_touch_state_t *st, const fl_touch_in_t *in) {
    const bool watched = fl_touch_watches(st, in);
    const float ripple_Nm = fl_touch_ripple(cfg, st, in);
    const float load_Nm = fl_touch_observe(cfg, st, in, ripple_Nm);
    const float speed = fl_abs(in->speed_rad_s);
    st->surge_rad_s2 =
        fl_max(fl_abs(in->acceleration_rad_s2), fl_fade(st->surge_rad_s2, FL_TOUCH_FADE, FL_LEAST_RAD));

    const float faster = fl_touch_late(st, speed) - st->mean_speed_rad_s, more_Nm = load_Nm - st->mean_Nm;
    st->rise_Nm = more_Nm - in->excess_Nms * faster;
    const float unrest_Nm = watched ? FL_LEAST_NM : fl_abs(more_Nm);
    st->unrest_Nm = fl_max(unrest_Nm, FL_TOUCH_REST * st->unrest_Nm);
    const float pace = fl_min(speed * (1.0f / FL_TOUCH_FAST_RAD_S), 1.0f);
    const float coarse = 1.0f + FL_TOUCH_COARSE * (1.0f - pace);
    /* until it is learnt, the scatter is taken for errors of the angle, which grow with w^2 */
    const float scale = st->share > 2.0f * FL_TOUCH_SHARE ? pace * pace : coarse;
    st->dip_Nm = fl_max(watched ? -st->rise_Nm : FL_LEAST_NM, FL_TOUCH_DIP_FADE * st->dip_Nm);
    const float both_Nm = coarse * fl_max(cfg->threshold_Nm, FL_TOUCH_DIPS * st->dip_Nm);
    const float known_Nm = fl_max(both_Nm, scale * FL_TOUCH_WILD * st->scatter_Nm);
    const float allowed_Nm = st->unrest_Nm + in->drag_doubt * cfg->doubt_Nms * fl_abs(faster) +
                             cfg->surge_kg_m2 * st->surge_rad_s2;
    st->limit_Nm = known_Nm + allowed_Nm;
    st->follow = watched ? fl_max(FL_TOUCH_MEAN, FL_TOUCH_CALM * st->follow) : FL_TOUCH_CATCH;
    if (watched && speed > FL_TOUCH_LEARN_RAD_S && allowed_Nm < FL_TOUCH_STILL * known_Nm) {
        st->scatter_Nm += st->share * (fl_abs(st->rise_Nm) - st->scatter_Nm);
        st->share = fl_max(FL_TOUCH_SHARE, FL_TOUCH_SETTLING * st->share);
        st->calm = st->rise_Nm < FL_TOUCH_HALF * st->limit_Nm ? st->share : 0.0f;
    } else {
        st->calm = 0.0f;
    }
    st->mean_Nm += st->follow * more_Nm;
    st->mean_speed_rad_s += st->follow * faster;
    return watched && st->rise_Nm > st->limit_Nm;
}

#endif
