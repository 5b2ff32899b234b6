/* The closed loop of one tick after the hall sensor: servo, commutation, collision. Kronig 2020, Eq. 20
 * to 22, one after the other; a host may run it over arrays of axes.
 */
#ifndef FL_DRIVE_H
#define FL_DRIVE_H

#include "fl_collision.h"
#include "fl_commutation.h"
#include "fl_port.h"
#include "fl_servo.h"

typedef struct fl_drive_out {
    fl_servo_out_t torque;
    float voltage; /* u_cmd/u_dc, -1..1 */
    fl_duty_t duty;
    bool stuck; /* Eq. 22 */
} fl_drive_out_t;

/* voltage_per_Nm: u_cmd/u_dc per Nm, Eq. 20a. rotor: measured at the start of the tick. */
static inline fl_drive_out_t fl_drive_step(const fl_servo_config_t *servo, float voltage_per_Nm,
                                           const fl_collision_config_t *collision, fl_servo_state_t *st,
                                           const fl_servo_in_t *in, fl_sincos_t rotor) {
    const fl_servo_out_t torque = fl_servo_step(servo, st, in, FL_TICK_S);
    const float voltage = fl_clamp(torque.torque_Nm * voltage_per_Nm, -1.0f, 1.0f);
    const fl_collision_in_t watch = {torque.watched_Nm, in->speed_rad_s, st->direction, st->drag_doubt};
    const fl_drive_out_t out = {torque, voltage,
                                fl_commutate(voltage, rotor, in->speed_rad_s * (0.5f * FL_TICK_S)),
                                fl_collision_closed(collision, watch)};
    return out;
}

#endif
