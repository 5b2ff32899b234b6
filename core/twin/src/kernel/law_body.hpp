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

#define X(type, name) +1
static_assert(4 * (0 FL_LAW_HALL(X)) == sizeof(fl_hall_config_t), "FL_LAW_HALL lists its fields");
static_assert(4 * (0 FL_LAW_SERVO(X)) == sizeof(fl_servo_config_t), "FL_LAW_SERVO lists its fields");
static_assert(4 * (0 FL_LAW_COLLISION(X)) == sizeof(fl_collision_config_t),
              "FL_LAW_COLLISION lists its fields");
static_assert(4 * (0 FL_LAW_TOUCH(X)) == sizeof(fl_touch_config_t), "FL_LAW_TOUCH lists its fields");
static_assert(4 * (0 FL_LAW_OBSERVER(X)) == sizeof(fl_touch_state_t), "FL_LAW_OBSERVER lists its fields");
static_assert(4 * (0 FL_LAW_STATE(X)) == sizeof(fl_servo_state_t), "FL_LAW_STATE lists its fields");
static_assert(4 * (0 FL_LAW_INPUT(X)) == sizeof(fl_servo_in_t), "FL_LAW_INPUT lists its fields");
static_assert(4 * (0 FL_LAW_TORQUE(X)) == sizeof(fl_servo_out_t), "FL_LAW_TORQUE lists its fields");
#undef X

// Not first samples: an axis that tracks has looked before.
void hall_law(LawBatch &b) {
    for (int i = 0; i < lane_group_size; ++i) {
#define X(type, name) b.hall.name[i],
        const fl_hall_config_t config = {FL_LAW_HALL(X)};
#undef X
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
    for (int i = 0; i < lane_group_size; ++i) {
#define X(type, name) b.servo.name[i],
        const fl_servo_config_t servo = {FL_LAW_SERVO(X)};
#undef X
#define X(type, name) b.collision.name[i],
        const fl_collision_config_t collision = {FL_LAW_COLLISION(X)};
#undef X
#define X(type, name) b.touch.name[i],
        const fl_touch_config_t touch = {FL_LAW_TOUCH(X)};
#undef X
        const fl_drive_config_t config = {servo, collision, touch, b.voltage_per_Nm[i], b.full_Nm[i]};
#define X(type, name) b.state.name[i],
        const fl_servo_state_t before = {FL_LAW_STATE(X)};
#undef X
#define X(type, name) b.observer.name[i],
        fl_drive_state_t state = {before, {FL_LAW_OBSERVER(X)}};
#undef X
#define X(type, name) static_cast<decltype(fl_servo_in_t::name)>(b.input.name[i]),
        const fl_servo_in_t in = {FL_LAW_INPUT(X)};
#undef X
        const fl_drive_out_t out = fl_drive_step(&config, &state, &in, {b.rotor_sin[i], b.rotor_cos[i]});
#define X(type, name) b.state.name[i] = state.servo.name;
        FL_LAW_STATE(X)
#undef X
#define X(type, name) b.observer.name[i] = state.touch.name;
        FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) b.torque.name[i] = out.torque.name;
        FL_LAW_TORQUE(X)
#undef X
        b.voltage[i] = out.voltage;
        b.duty_a[i] = out.duty.phase[0];
        b.duty_b[i] = out.duty.phase[1];
        b.duty_c[i] = out.duty.phase[2];
        b.stuck[i] = out.stuck;
    }
}

} // namespace
} // namespace fl::twin
