/* From a torque or a field to the three phases.
 *
 * Kronig 2020, Eq. 18: u_A, u_B, u_C = u_cmd/2 (1 + cos(theta_field + 120, - 120, 0 deg)).
 * Eq. 20: closed loop puts the field 90 degrees ahead of the rotor on the side of the torque.
 */
#ifndef FL_COMMUTATION_H
#define FL_COMMUTATION_H

#include "fl_math.h"

typedef struct fl_duty {
    float phase[3]; /* A, B, C as fractions of u_dc, 0..1 */
} fl_duty_t;

/* Eq. 18 for a field of strength u (0..1 of u_dc) with u cos and u sin of its angle. */
static inline fl_duty_t fl_field_duty(float u, float u_cos, float u_sin) {
    const float half_sqrt3 = 0.8660254f;
    const fl_duty_t out = {{fl_clamp(0.5f * (u - 0.5f * u_cos - half_sqrt3 * u_sin), 0.0f, 1.0f),
                            fl_clamp(0.5f * (u - 0.5f * u_cos + half_sqrt3 * u_sin), 0.0f, 1.0f),
                            fl_clamp(0.5f * (u + u_cos), 0.0f, 1.0f)}};
    return out;
}

/* Eq. 20: voltage (-1..1 of u_dc, its sign that of the torque) at the rotor's angle, turned on by
 * lead_rad to where the rotor will be in the middle of the coming tick (|lead| < 0.2). */
static inline fl_duty_t fl_commutate(float voltage, fl_sincos_t rotor, float lead_rad) {
    const float s = rotor.sin + rotor.cos * lead_rad;
    const float c = rotor.cos - rotor.sin * lead_rad;
    /* one Newton step to unit length: the sensors' gain errors must not change the torque */
    const float norm = voltage * (1.5f - 0.5f * (s * s + c * c));
    return fl_field_duty(fl_abs(voltage), -norm * s, norm * c);
}

/* Open loop: the magnet follows a field of strength u at this motor angle. */
static inline fl_duty_t fl_rotating_field(float u, int32_t field_cnt) {
    const fl_sincos_t f = fl_sincos_cnt(field_cnt);
    return fl_field_duty(u, u * f.cos, u * f.sin);
}

#endif
