/* The closed loop of one tick after the hall sensor: servo, commutation, collision, touch. Kronig
 * 2020, Eq. 20 to 22, one after the other; a host may run it over arrays of axes.
 */
#ifndef FL_DRIVE_H
#define FL_DRIVE_H

#include "fl_collision.h"
#include "fl_commutation.h"
#include "fl_servo.h"
#include "fl_touch.h"

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
    float voltage_per_Nm, full_Nm; /* u_cmd/u_dc per Nm, Eq. 20a, and its inverse */
} fl_drive_config_t;

typedef struct fl_drive_state {
    fl_servo_state_t servo;
    fl_touch_state_t touch;
} fl_drive_state_t;
/* The touch watch of this tick (fl_touch.h): `torque` is what the servo has asked for, `voltage` what of it
 * the supply gives (-1..1 of u_dc). True when the arm is touched.
 * @pre after fl_servo_step of the same tick */
static inline bool fl_drive_touched(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                    const fl_servo_in_t *in, const fl_servo_out_t *torque, float voltage) {
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
    };
    return fl_touch_step(&cfg->touch, &st->touch, &touch);
}

/* rotor: measured at the start of the tick. */
static inline fl_drive_out_t fl_drive_step(const fl_drive_config_t *cfg, fl_drive_state_t *st,
                                           const fl_servo_in_t *in, fl_sincos_t rotor) {
    const fl_servo_out_t torque = fl_servo_step(&cfg->servo, &st->servo, in, FL_TICK_S);
    const float voltage = fl_clamp(torque.torque_Nm * cfg->voltage_per_Nm, -1.0f, 1.0f);
    const fl_collision_in_t watch = {torque.watched_Nm, in->speed_rad_s, st->servo.direction,
                                     st->servo.drag_doubt};
    const bool touched = fl_drive_touched(cfg, st, in, &torque, voltage);
    const bool collided = fl_collision_closed(&cfg->collision, watch);
    const fl_drive_out_t out = {torque, voltage,
                                fl_commutate(voltage, rotor, in->speed_rad_s * (0.5f * FL_TICK_S)),
                                collided || touched};
    return out;
}

#endif
