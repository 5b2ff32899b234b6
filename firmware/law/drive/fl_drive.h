/* The closed loop of one tick after the hall sensor: servo or regulator, commutation, collision, touch.
 * Kronig 2020, Eq. 20 to 22, one after the other; a host may run it over arrays of axes.
 */
#ifndef FL_DRIVE_H
#define FL_DRIVE_H

#include "fl_collision.h"
#include "fl_commutation.h"
#include "fl_regulator.h"
#include "fl_servo.h"
#include "fl_touch.h"

typedef enum fl_law {
    FL_LAW_PAPER,   /* Eq. 21: fl_servo.h */
    FL_LAW_CONTACT, /* fl_regulator.h */
} fl_law_t;

typedef struct fl_drive_out {
    fl_servo_out_t torque;
    float voltage; /* u_cmd/u_dc, -1..1 */
    fl_duty_t duty;
    bool stuck; /* Eq. 22, or a touch */
} fl_drive_out_t;

typedef struct fl_drive_config {
    fl_servo_config_t servo;
    fl_collision_config_t collision;
    fl_touch_config_t touch;
    fl_teeth_config_t teeth;
    fl_regulator_config_t regulator;
    float voltage_per_Nm, full_Nm; /* u_cmd/u_dc per Nm, Eq. 20a, and its inverse */
    int32_t law;                   /* fl_law_t */
} fl_drive_config_t;

typedef struct fl_drive_state {
    fl_servo_state_t servo;
    fl_touch_state_t touch;
    fl_teeth_state_t teeth;
    fl_regulator_state_t regulator;
} fl_drive_state_t;

/* The touch watch of this tick (fl_touch.h): `torque` is what the servo has asked for, `voltage` what of it
 * the supply gives (-1..1 of u_dc). True when the arm is touched.
 * @pre after fl_servo_step of the same tick */
static inline __attribute__((always_inline)) bool
fl_drive_touched(const fl_drive_config_t *cfg, fl_drive_state_t *st, const fl_servo_in_t *in,
                 const fl_servo_out_t *torque, float voltage, fl_sincos_t rotor) {
    const float excess_Nms = cfg->servo.drag * (st->servo.drag_scale - 1.0f);
    const float expected_Nm = torque->feedforward_Nm - excess_Nms * in->speed_rad_s;
    const fl_touch_in_t touch = {
        (float)in->error_cnt * FL_RAD_PER_CNT,
        voltage * cfg->full_Nm - expected_Nm,
        excess_Nms,
        in->speed_rad_s,
        st->servo.direction,
        in->acceleration_rad_s2,
        st->servo.drag_doubt,
        (float)st->teeth.touching,
        rotor.sin,
        rotor.cos,
    };
    return fl_touch_step(&cfg->touch, &st->touch, &touch);
}

/* What of a torque the supply gives, -1..1 of u_dc. */
static inline float fl_drive_voltage(const fl_drive_config_t *cfg, float torque_Nm) {
    return fl_clamp(torque_Nm * cfg->voltage_per_Nm, -1.0f, 1.0f);
}

/* Eq. 22 for what the servo has asked for: true when the rotor or the arm is blocked.
 * @pre the servo's state is that of this tick */
static inline __attribute__((always_inline)) bool fl_drive_collided(const fl_drive_config_t *cfg,
                                                                    const fl_servo_state_t *servo,
                                                                    float watched_Nm, float speed_rad_s) {
    const fl_collision_in_t watch = {watched_Nm, speed_rad_s, servo->direction, servo->drag_doubt};
    return fl_collision_closed(&cfg->collision, watch);
}

/* The phases of this tick. */
static inline __attribute__((always_inline)) fl_duty_t fl_drive_phases(float voltage, fl_sincos_t rotor,
                                                                       float speed_rad_s) {
    return fl_commutate(voltage, rotor, speed_rad_s * (0.5f * FL_TICK_S));
}

/* Commutation and the watches, after either law. Left to itself the compiler makes one function of the two
 * uses: 40 instructions a tick and axis.
 * @pre the servo's state is that of this tick */
static inline __attribute__((always_inline)) fl_drive_out_t fl_drive_end(const fl_drive_config_t *cfg,
                                                                         fl_drive_state_t *st,
                                                                         const fl_servo_in_t *in,
                                                                         fl_sincos_t rotor,
                                                                         const fl_servo_out_t *torque) {
    const float voltage = fl_drive_voltage(cfg, torque->torque_Nm);
    const bool touched = fl_drive_touched(cfg, st, in, torque, voltage, rotor);
    const bool collided = fl_drive_collided(cfg, &st->servo, torque->watched_Nm, in->speed_rad_s);
    const fl_drive_out_t out = {*torque, voltage, fl_drive_phases(voltage, rotor, in->speed_rad_s),
                                collided || touched};
    return out;
}

/* Eq. 21; rotor: measured at the start of the tick. */
static inline fl_drive_out_t fl_drive_paper(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                            const fl_servo_in_t *in, fl_sincos_t rotor) {
    const fl_servo_out_t torque = fl_servo_step(&cfg->servo, &st->servo, in, FL_TICK_S);
    return fl_drive_end(cfg, st, in, rotor, &torque);
}

/* The torque of the state feedback, with the feedforward of the gear only while it is pushed. */
static inline fl_servo_out_t fl_drive_contact_torque(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                                     const fl_servo_in_t *in) {
    fl_servo_head(&st->servo, in->speed_rad_s);
    const fl_gap_t gap = fl_teeth_step(&cfg->teeth, &st->teeth, fl_sub_i32(in->rotor_cnt, in->error_cnt),
                                       fl_sub_i32(in->command_cnt, in->rotor_cnt));
    const int32_t pushes = fl_regulator_pushes(gap, st->servo.direction, in->speed_rad_s);
    st->teeth.touching = cfg->teeth.mean_cnt > 0.0f ? pushes : 0;
    const fl_servo_out_t torque =
        fl_regulator_step(&cfg->servo, &cfg->regulator, &st->servo, &st->regulator, in, pushes);
    const float applied_Nm = fl_drive_voltage(cfg, torque.torque_Nm) * cfg->full_Nm;
    fl_regulator_applied(&cfg->regulator, &st->regulator, applied_Nm - torque.feedforward_Nm);
    return torque;
}

/* State feedback (fl_regulator.h). */
static inline fl_drive_out_t fl_drive_contact(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                              const fl_servo_in_t *in, fl_sincos_t rotor) {
    const fl_servo_out_t torque = fl_drive_contact_torque(cfg, st, in);
    return fl_drive_end(cfg, st, in, rotor, &torque);
}

/* By the law of the configuration. */
static inline fl_drive_out_t fl_drive_step(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                           const fl_servo_in_t *in, fl_sincos_t rotor) {
    return cfg->law == FL_LAW_CONTACT ? fl_drive_contact(cfg, st, in, rotor)
                                      : fl_drive_paper(cfg, st, in, rotor);
}

#endif
