/* State feedback with a disturbance estimate, in the place of Eq. 21's PI, and its feedforward only while the
 * teeth touch.
 *
 *   T' = k_e e + k_v e' + J load                      e, e', load: fl_observer.h
 *      + T_cog(theta)                                 always
 *      + max(c_coulomb - S sgn(w), 0) sgn(w) + c_tot w    while the motor pushes the gear (fl_teeth.h)
 *      + gap_coulomb sgn(w) + gap_drag w              in the gap: the rotor alone
 *      + J dw/dt
 *
 * k_e and k_v place the poles of e'' = -(k_e e + k_v e' + c e')/J. What saturates is known to the observer,
 * so nothing winds up. The drag is learnt from the load, as by Eq. 21 from its feedback, while the teeth
 * touch. Eq. 22 watches k_p e + J load: the same measure as that of the other law, with the load for the
 * integral.
 */
#ifndef FL_REGULATOR_H
#define FL_REGULATOR_H

#include "fl_observer.h"
#include "fl_servo.h"
#include "fl_teeth.h"

/* Nearer than this the teeth are taken to touch: 2 motor degrees, of what the backlash may be wrong by. */
#define FL_TEETH_NEAR_CNT ((int32_t)(2.0 * FL_TURN_CNT / 360.0))

#define FL_SLACK_FADE 0.9f /* per tick: 5 ms */

typedef struct fl_regulator_config {
    float k_e, k_v;                 /* Nm/rad, Nm s/rad */
    float gain_e, gain_v, gain_a;   /* of the observer */
    float inertia, inertia_inverse; /* kg m^2 */
    float drag;                     /* Nm s/rad, of the model of the observer */
    float gap_coulomb, gap_drag;    /* Nm, Nm s/rad: of the rotor alone */
} fl_regulator_config_t;

typedef struct fl_regulator_state {
    fl_observer_state_t seen;
    float slack_Nm; /* what the gear may resist with, unknown to the feedforward */
} fl_regulator_state_t;

/* 1 while the motor pushes the gear in its commanded direction, in the middle of the coming tick. */
static inline int32_t fl_regulator_pushes(fl_gap_t gap, float direction, float speed_rad_s) {
    const int32_t lead = (int32_t)(fl_abs(speed_rad_s) * (0.5f * FL_TICK_S * FL_CNT_PER_RAD));
    const int32_t left = direction < 0.0f ? gap.below_cnt : gap.above_cnt;
    return left - lead <= FL_TEETH_NEAR_CNT;
}

/* What pushing the gear takes more than turning the rotor alone, in the direction of the command, Nm.
 * @pre st->direction is that of this tick */
static inline float fl_regulator_gear(const fl_servo_config_t *cfg, const fl_regulator_config_t *reg,
                                      const fl_servo_state_t *st, const fl_servo_in_t *in) {
    const float spring = -cfg->spring_torque - cfg->spring_rate * ((float)in->command_cnt * FL_RAD_PER_CNT);
    /* the gear takes friction and spring from the rotor, and never gives */
    const float resists = fl_max(cfg->coulomb + spring * st->direction, 0.0f);
    return resists - reg->gap_coulomb +
           (cfg->drag * st->drag_scale - reg->gap_drag) * fl_abs(in->speed_rad_s);
}

/* The feedforward of the rotor alone, Nm.
 * @pre st->direction is that of this tick */
static inline float fl_regulator_rotor(const fl_servo_config_t *cfg, const fl_regulator_config_t *reg,
                                       const fl_servo_state_t *st, const fl_servo_in_t *in) {
    const int32_t twice_cnt = fl_add_i32(in->rotor_cnt, in->rotor_cnt);
    const float cogging = cfg->cogging * fl_sin_cnt(fl_add_i32(twice_cnt, cfg->cogging_phase_cnt));
    return cogging + reg->gap_coulomb * st->direction + reg->gap_drag * in->speed_rad_s +
           cfg->inertia * in->acceleration_rad_s2;
}

/* Learns the drag from the load at speed, as fl_servo_step does. */
static inline void fl_regulator_learn(const fl_servo_config_t *cfg, fl_servo_state_t *st, float speed_rad_s,
                                      float load_Nm) {
    const float pace = fl_clamp(speed_rad_s, -FL_LEARNING_RAD_S, FL_LEARNING_RAD_S);
    st->drag_doubt += (FL_DOUBT_LAST - st->drag_doubt) * (cfg->doubting * FL_TICK_S * pace * pace);
    st->drag_scale = fl_clamp(st->drag_scale + cfg->learning * FL_TICK_S * pace * load_Nm, 0.5f, 2.0f);
}

/* The torque of this tick, before the supply limits it.
 * @pre fl_regulator_applied ends the tick */
static inline fl_servo_out_t fl_regulator_step(const fl_servo_config_t *cfg, const fl_regulator_config_t *reg,
                                               fl_servo_state_t *st, fl_regulator_state_t *own,
                                               const fl_servo_in_t *in, int32_t pushes) {
    const float e_rad = (float)in->error_cnt * FL_RAD_PER_CNT;
    const fl_observer_gains_t gains = {reg->gain_e, reg->gain_v, reg->gain_a};
    fl_observer_correct(&gains, &own->seen, e_rad);
    const float load_Nm = reg->inertia * own->seen.load_rad_s2;
    fl_regulator_learn(cfg, st, pushes ? in->speed_rad_s : 0.0f, load_Nm);
    const float gear = fl_regulator_gear(cfg, reg, st, in);
    const float feedforward = fl_regulator_rotor(cfg, reg, st, in) + (pushes ? gear * st->direction : 0.0f);
    own->slack_Nm = pushes ? fl_fade(own->slack_Nm, FL_SLACK_FADE, FL_LEAST_NM) : fl_max(gear, 0.0f);
    const float feedback = reg->k_e * own->seen.error_rad + reg->k_v * own->seen.rate_rad_s + load_Nm;
    const float watched = cfg->k_p * e_rad + load_Nm - own->slack_Nm * st->direction;
    const fl_servo_out_t out = {feedforward + feedback, feedforward, watched};
    return out;
}

/* Ends the tick: the torque that the supply gives, beyond the feedforward. */
static inline void fl_regulator_applied(const fl_regulator_config_t *reg, fl_regulator_state_t *own,
                                        float beyond_Nm) {
    fl_observer_predict(&own->seen, (beyond_Nm + reg->drag * own->seen.rate_rad_s) * reg->inertia_inverse);
}

#endif
