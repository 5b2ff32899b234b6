/* Feedforward and PI on the motor angle: Kronig 2020, Eq. 21, with every feedforward quantity taken
 * from the command, never from a differentiated measurement.
 *
 *   T' = k_p e + I                                   feedback, I = integral of k_i e, |I| <= T_I_max
 *      + T_cog(theta) - S(theta) + c_coulomb sgn(w)  break-away torque
 *      + c_tot w + J dw/dt                           speed and inertia
 *
 * S is the spring's torque on the motor: EQUATIONS T_spring with the other sign. The Coulomb term
 * keeps the sign of the last commanded direction at standstill. While settling both gains are
 * multiplied by settle_gain: the drag no longer hides a small remaining error; Eq. 22 watches the
 * term without that factor.
 */
#ifndef FL_SERVO_H
#define FL_SERVO_H

#include "fl_math.h"

#define FL_SETTLE_RAD 0.05f   /* 3 motor degrees */
#define FL_DOUBT_FIRST 0.4f   /* grease half or twice as stiff: -19, +38 % of the drag */
#define FL_DOUBT_TURNED 0.12f /* learnt the other way: the spring, wrong by 15 uNm, was in it */
#define FL_DOUBT_LAST 0.05f
#define FL_LEARNING_RAD_S 209.44f /* 2000 rpm */

typedef struct fl_servo_config {
    float k_p, k_i;                   /* Nm/rad, Nm/(rad s) */
    float settle_gain;                /* factor on both while settling */
    float integral_limit;             /* Nm */
    float drag, inertia;              /* Nm s/rad, kg m^2: zero switches the term off */
    float doubting;                   /* s/rad^2: how fast the doubt goes, half as fast as it is learnt */
    float learning;                   /* 1/(Nm rad): how fast the drag's scale follows the feedback */
    float coulomb;                    /* Nm */
    float spring_torque, spring_rate; /* Nm at output zero, Nm per motor rad */
    float cogging;                    /* Nm: amplitude of sin(2 theta + phase) */
    int32_t cogging_phase_cnt;
} fl_servo_config_t;

typedef struct fl_servo_state {
    float integral_Nm;
    float direction;  /* -1, 0 or 1: the last commanded one */
    float drag_doubt; /* share of the drag that may not be learnt yet: FL_DOUBT_FIRST .. FL_DOUBT_LAST */
    float drag_scale; /* learnt: 1 as identified; grease is half as stiff or twice with temperature */
} fl_servo_state_t;

typedef struct fl_servo_in {
    int32_t error_cnt;   /* commanded minus measured motor angle */
    int32_t command_cnt; /* commanded position, zero at output zero */
    int32_t rotor_cnt;   /* the same as the rotor's angle, whole turns free */
    float speed_rad_s, acceleration_rad_s2;
    bool settling; /* at creep speed or standing, at the end of a move */
} fl_servo_in_t;

typedef struct fl_servo_out {
    float torque_Nm, feedforward_Nm;
    float watched_Nm; /* the feedback term of Eq. 22 */
} fl_servo_out_t;

/* Takes the direction of a command that moves; after a turn the learnt drag is doubted again. */
static inline void fl_servo_head(fl_servo_state_t *st, float speed_rad_s) {
    if (speed_rad_s == 0.0f) return;
    const float direction = speed_rad_s < 0.0f ? -1.0f : 1.0f;
    const float least = direction == st->direction ? 0.0f : FL_DOUBT_TURNED;
    st->drag_doubt = fl_max(st->drag_doubt, least);
    st->direction = direction;
}

/* The break-away torque of Eq. 21 at the commanded angle, Nm, for a motion in `direction` (-1, 0 or 1). */
static inline float fl_servo_break_away(const fl_servo_config_t *cfg, const fl_servo_in_t *in,
                                        float direction) {
    const int32_t twice_cnt = fl_add_i32(in->rotor_cnt, in->rotor_cnt);
    const float motor_rad = (float)in->command_cnt * FL_RAD_PER_CNT;
    return cfg->coulomb * direction - cfg->spring_torque - cfg->spring_rate * motor_rad +
           cfg->cogging * fl_sin_cnt(fl_add_i32(twice_cnt, cfg->cogging_phase_cnt));
}

/* Eq. 21: the torque of this tick, of which dt_s is the length in s; integral, direction and learnt drag in
 * `st` move on.
 * @pre dt_s > 0; cfg->integral_limit >= 0 */
static inline fl_servo_out_t fl_servo_step(const fl_servo_config_t *cfg, fl_servo_state_t *st,
                                           const fl_servo_in_t *in, float dt_s) {
    const float e_rad = (float)in->error_cnt * FL_RAD_PER_CNT;
    fl_servo_head(st, in->speed_rad_s);
    const float gain = in->settling ? cfg->settle_gain : 1.0f;
    /* what is left of a fast arrival must not fill the integral */
    const float e_integral = in->settling ? fl_clamp(e_rad, -FL_SETTLE_RAD, FL_SETTLE_RAD) : e_rad;
    st->integral_Nm = fl_clamp(st->integral_Nm + cfg->k_i * gain * dt_s * e_integral, -cfg->integral_limit,
                               cfg->integral_limit);
    const float proportional = cfg->k_p * e_rad;
    const float pace = fl_clamp(in->speed_rad_s, -FL_LEARNING_RAD_S, FL_LEARNING_RAD_S);
    st->drag_doubt += (FL_DOUBT_LAST - st->drag_doubt) * (cfg->doubting * dt_s * pace * pace);
    st->drag_scale =
        fl_clamp(st->drag_scale + cfg->learning * dt_s * pace * (proportional + st->integral_Nm), 0.5f, 2.0f);
    const float feedforward = fl_servo_break_away(cfg, in, st->direction) +
                              cfg->drag * st->drag_scale * in->speed_rad_s +
                              cfg->inertia * in->acceleration_rad_s2;
    const fl_servo_out_t out = {proportional * gain + st->integral_Nm + feedforward, feedforward,
                                proportional + st->integral_Nm};
    return out;
}

#endif
