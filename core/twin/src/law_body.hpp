// The laws over a LawBatch; included by kernel_body.hpp, compiled for every instruction set. The firmware's
// functions are static inline, so no copy of them leaves its object file.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
#include "fl_drive.h"
#include "fl_hall.h"
#pragma GCC diagnostic pop

#include "fiberloom/twin/law_batch.hpp"

namespace fl::twin {
namespace {

// Not first samples: an axis sets out from a known angle.
void hall_law(LawBatch &b) {
    for (int i = 0; i < squad_size; ++i) {
        const fl_hall_config_t config = {b.hall_offset_a[i], b.hall_offset_b[i],  b.hall_gain_a[i],
                                         b.hall_gain_b[i],   b.hall_sec_phase[i], b.hall_tan_phase[i]};
        fl_hall_state_t state = {b.angle_cnt[i], true};
        const uint16_t adc_cnt[2] = {static_cast<uint16_t>(b.adc_a_cnt[i]),
                                     static_cast<uint16_t>(b.adc_b_cnt[i])};
        const fl_hall_out_t out = fl_hall_step(&config, &state, adc_cnt);
        b.angle_cnt[i] = out.angle_cnt;
        b.rotor_sin[i] = out.rotor.sin;
        b.rotor_cos[i] = out.rotor.cos;
    }
}

void drive_law(LawBatch &b) {
    for (int i = 0; i < squad_size; ++i) {
        const fl_servo_config_t servo = {
            b.k_p[i],         b.k_i[i],      b.integral_limit[i],   b.drag[i],
            b.inertia[i],     b.learning[i], b.coulomb[i],          b.spring_torque[i],
            b.spring_rate[i], b.cogging[i],  b.cogging_phase_cnt[i]};
        const fl_collision_config_t collision = {b.threshold_Nm[i], b.drag_doubt[i], 0};
        fl_servo_state_t state = {b.integral_Nm[i], b.direction[i], b.drag_scale[i]};
        const fl_servo_in_t in = {b.error_cnt[i],   b.command_cnt[i],         b.rotor_cnt[i],
                                  b.speed_rad_s[i], b.acceleration_rad_s2[i], b.stiffness[i]};
        const fl_drive_out_t out = fl_drive_step(&servo, b.voltage_per_Nm[i], &collision, &state, &in,
                                                 {b.rotor_sin[i], b.rotor_cos[i]});
        b.integral_Nm[i] = state.integral_Nm;
        b.direction[i] = state.direction;
        b.drag_scale[i] = state.drag_scale;
        b.torque_Nm[i] = out.torque.torque_Nm;
        b.feedforward_Nm[i] = out.torque.feedforward_Nm;
        b.watched_Nm[i] = out.torque.watched_Nm;
        b.voltage[i] = out.voltage;
        b.duty_a[i] = out.duty.phase[0];
        b.duty_b[i] = out.duty.phase[1];
        b.duty_c[i] = out.duty.phase[2];
        b.stuck[i] = out.stuck;
    }
}

} // namespace
} // namespace fl::twin
