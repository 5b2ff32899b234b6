// The laws over a LawBatch; included by kernel_body.hpp, compiled for every instruction set. The firmware's
// functions are static inline, so no copy of them leaves its object file.
#define FL_SIDE_BY_SIDE
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
#include "fl_drive.h"
#include "fl_hall.h"
#include "fl_landing.h"
#include "fl_path.h"
#include "fl_profile.h"
#include "fl_smooth.h"
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
static_assert(4 * (0 FL_LAW_OBSERVER(X)) + sizeof(fl_ripple_state_t) == sizeof(fl_touch_state_t),
              "FL_LAW_OBSERVER lists its fields");
static_assert(4 * (0 FL_LAW_RIPPLE(X)) == sizeof(fl_ripple_state_t), "FL_LAW_RIPPLE lists its fields");
static_assert(4 * (0 FL_LAW_TEETH(X)) == sizeof(fl_teeth_config_t), "FL_LAW_TEETH lists its fields");
static_assert(4 * (0 FL_LAW_REGULATOR(X)) == sizeof(fl_regulator_config_t),
              "FL_LAW_REGULATOR lists its fields");
static_assert(4 * (0 FL_LAW_GAP(X)) == sizeof(fl_teeth_state_t), "FL_LAW_GAP lists its fields");
static_assert(4 * (0 FL_LAW_SEEN(X)) == sizeof(fl_observer_state_t), "FL_LAW_SEEN lists its fields");
static_assert(sizeof(fl_regulator_state_t) == sizeof(fl_observer_state_t) + 4, "and the slack");
static_assert(4 * (0 FL_LAW_STATE(X)) == sizeof(fl_servo_state_t), "FL_LAW_STATE lists its fields");
static_assert(4 * (0 FL_LAW_INPUT(X)) == sizeof(fl_servo_in_t), "FL_LAW_INPUT lists its fields");
static_assert(4 * (0 FL_LAW_TORQUE(X)) == sizeof(fl_servo_out_t), "FL_LAW_TORQUE lists its fields");
static_assert(4 * (0 FL_LAW_SETTLE(X)) == sizeof(fl_settle_config_t), "FL_LAW_SETTLE lists its fields");
static_assert(4 * (0 FL_LAW_WAIT(X)) == sizeof(fl_settle_state_t), "FL_LAW_WAIT lists its fields");
#undef X

// Not first samples: an axis that tracks has looked before.
void hall_law(LawBatch &__restrict b, LawScratch &__restrict s) {
    for (int i = 0; i < lane_group_size; ++i) {
#define X(type, name) b.hall.name[i],
        const fl_hall_config_t config = {FL_LAW_HALL(X)};
#undef X
        fl_hall_state_t state = {b.angle_cnt[i], true};
        // fl_hall_step, but for 16-bit counts, of which a vector holds too many for the rest
        const fl_sincos_t rotor =
            fl_hall_rotor(&config, static_cast<float>(b.adc_a_cnt[i]), static_cast<float>(b.adc_b_cnt[i]));
        const fl_hall_out_t out = fl_hall_follow(&state, rotor);
        b.angle_cnt[i] = out.angle_cnt;
        s.rotor_sin[i] = out.rotor.sin;
        s.rotor_cos[i] = out.rotor.cos;
    }
}

static_assert(smooth_ticks == FL_SMOOTH_TICKS);

void go_along(LawBatch &__restrict b, LawScratch &__restrict s) {
    for (int i = 0; i < lane_group_size; ++i) {
        b.way.goto_q30[i] += b.way.speed_q30[i];
        b.way.speed_q30[i] += b.way.change_q30[i];
    }
    for (int i = 0; i < lane_group_size; ++i) s.goto_cnt[i] = fl_profile_cnt(b.way.goto_q30[i]);
    for (int i = 0; i < lane_group_size; ++i) {
        fl_path_cursor_t cursor = {b.way.path_cnt[i],
                                   b.way.step_cnt[i],
                                   b.way.rest[i],
                                   b.way.rest_sum[i],
                                   1,
                                   static_cast<uint32_t>(b.way.ticks[i]),
                                   0};
        fl_path_go(&cursor);
        b.way.path_cnt[i] = cursor.position_cnt;
        b.way.rest_sum[i] = cursor.rest_sum;
    }
    for (int i = 0; i < lane_group_size; ++i) {
        const int32_t way_cnt = fl_sub_i32(b.way.target_cnt[i], b.way.path_cnt[i]);
        const int32_t step_cnt = fl_landing_step(way_cnt, b.way.slowest_cnt[i]);
        b.way.path_cnt[i] =
            fl_add_i32(b.way.path_cnt[i], (way_cnt > 0 ? step_cnt : -step_cnt) & b.way.lands[i]);
    }
}

// fl_smooth_step and what the servo is asked, of the same tick for all lanes.
void smooth(LawBatch &__restrict b, LawScratch &__restrict s, int32_t *__restrict ring_cnt) {
    for (int i = 0; i < lane_group_size; ++i) {
        const int32_t raw_cnt = (b.way.path_cnt[i] & b.way.follows[i]) | (s.goto_cnt[i] & ~b.way.follows[i]);
        s.change_cnt[i] = fl_sub_i32(raw_cnt, ring_cnt[i]);
        ring_cnt[i] = raw_cnt;
    }
    for (int i = 0; i < lane_group_size; ++i) {
        const fl_command_t command =
            fl_smooth_command(b.way.value_cnt[i], s.change_cnt[i], b.way.speed_rad_s[i]);
        b.way.command_cnt[i] = command.position_cnt;
        b.way.speed_rad_s[i] = command.speed_rad_s;
        b.way.acceleration_rad_s2[i] = command.acceleration_rad_s2;
        const int32_t measured_cnt = fl_add_i32(b.angle_cnt[i], b.way.zero_cnt[i]);
        s.input.error_cnt[i] = fl_sub_i32(command.position_cnt, measured_cnt);
        s.input.command_cnt[i] = command.position_cnt;
        s.input.rotor_cnt[i] = fl_sub_i32(command.position_cnt, b.way.zero_cnt[i]);
        s.input.speed_rad_s[i] = command.speed_rad_s;
        s.input.acceleration_rad_s2[i] = command.acceleration_rad_s2;
        s.input.settling[i] = b.way.creeps[i];
    }
    for (int i = 0; i < lane_group_size; ++i) b.way.sum_cnt[i] += s.change_cnt[i];
    for (int i = 0; i < lane_group_size; ++i) b.way.value_cnt[i] = fl_smooth_mean(b.way.sum_cnt[i]);
}

void advance_law(LawBatch &b, LawScratch &s, uint64_t tick) {
    go_along(b, s);
    smooth(b, s, b.way.ring_cnt[tick % smooth_ticks]);
}

// After the drive's law.
void settle_law(LawBatch &__restrict b, LawScratch &__restrict s) {
    for (int i = 0; i < lane_group_size; ++i) {
#define X(type, name) b.settle.name[i],
        const fl_settle_config_t config = {FL_LAW_SETTLE(X)};
        fl_settle_state_t state = {FL_LAW_WAIT(X)};
#undef X
        const int32_t error_cnt = s.input.error_cnt[i];
        const bool over =
            fl_settle_step(&config, &state, b.state.direction[i] < 0.0f ? -error_cnt : error_cnt);
        s.settled[i] = int32_t{over};
#define X(type, name) b.settle.name[i] = over ? b.settle.name[i] : state.name;
        FL_LAW_WAIT(X)
#undef X
    }
}

// The configuration of a lane's drive. c: of the contact's law, else a nullptr.
template <fl_law_t Law>
inline fl_drive_config_t drive_config_of(const LawBatch &b, const ContactLanes *c, int i) {
#define X(type, name) b.servo.name[i],
    const fl_servo_config_t servo = {FL_LAW_SERVO(X)};
#undef X
#define X(type, name) b.collision.name[i],
    const fl_collision_config_t collision = {FL_LAW_COLLISION(X)};
#undef X
#define X(type, name) b.touch.name[i],
    const fl_touch_config_t touch = {FL_LAW_TOUCH(X)};
#undef X
#define X(type, name) Law == FL_LAW_CONTACT ? c->teeth.name[i] : type{},
    const fl_teeth_config_t teeth = {FL_LAW_TEETH(X)};
#undef X
#define X(type, name) Law == FL_LAW_CONTACT ? c->regulator.name[i] : type{},
    const fl_regulator_config_t regulator = {FL_LAW_REGULATOR(X)};
#undef X
    return {servo, collision, touch, teeth, regulator, b.voltage_per_Nm[i], b.full_Nm[i], b.law[i]};
}

template <fl_law_t Law>
inline fl_drive_state_t drive_state_of(const LawBatch &b, const ContactLanes *c, int i) {
#define X(type, name) b.state.name[i],
    const fl_servo_state_t servo = {FL_LAW_STATE(X)};
#undef X
#define X(type, name) b.ripple.name[i],
    const fl_ripple_state_t ripple = {FL_LAW_RIPPLE(X)};
#undef X
#define X(type, name) b.observer.name[i],
    const fl_touch_state_t touch = {FL_LAW_OBSERVER(X) ripple};
#undef X
#define X(type, name) Law == FL_LAW_CONTACT ? c->gap.name[i] : type{},
    const fl_teeth_state_t teeth = {FL_LAW_GAP(X)};
#undef X
#define X(type, name) Law == FL_LAW_CONTACT ? c->seen.name[i] : type{},
    const fl_observer_state_t seen = {FL_LAW_SEEN(X)};
#undef X
    return {servo, touch, teeth, {seen, Law == FL_LAW_CONTACT ? c->slack_Nm[i] : 0.0f}};
}

// fl_drive_step in three loops: with all of it in one, a processor finds too little to do while it waits for
// results.

#define X(type, name) static_cast<decltype(fl_servo_in_t::name)>(s.input.name[i]),
inline fl_servo_in_t servo_in_of(const LawScratch &s, int i) { return {FL_LAW_INPUT(X)}; }
#undef X

// The torque by one law, for all lanes; with `some`, only what those of this law have found is kept.
template <fl_law_t Law, bool some>
[[gnu::flatten]] void torque_lanes(LawBatch &__restrict b, LawScratch &__restrict s,
                                   ContactLanes *__restrict c) {
    for (int i = 0; i < lane_group_size; ++i) {
        const bool mine = !some || b.law[i] == Law;
        const fl_drive_config_t config = drive_config_of<Law>(b, c, i);
        fl_drive_state_t state = drive_state_of<Law>(b, c, i);
        const fl_servo_in_t in = servo_in_of(s, i);
        const fl_servo_out_t out = Law == FL_LAW_CONTACT
                                       ? fl_drive_contact_torque(&config, &state, &in)
                                       : fl_servo_step(&config.servo, &state.servo, &in, FL_TICK_S);
#define X(type, name) b.state.name[i] = mine ? state.servo.name : b.state.name[i];
        FL_LAW_STATE(X)
#undef X
#define X(type, name) c->gap.name[i] = mine ? state.teeth.name : c->gap.name[i];
        if (Law == FL_LAW_CONTACT) {
            FL_LAW_GAP(X)
        }
#undef X
#define X(type, name) c->seen.name[i] = mine ? state.regulator.seen.name : c->seen.name[i];
        if (Law == FL_LAW_CONTACT) {
            FL_LAW_SEEN(X)
            c->slack_Nm[i] = mine ? state.regulator.slack_Nm : c->slack_Nm[i];
        }
#undef X
#define X(type, name) b.torque.name[i] = mine ? out.name : b.torque.name[i];
        FL_LAW_TORQUE(X)
#undef X
        b.voltage[i] = mine ? fl_drive_voltage(&config, out.torque_Nm) : b.voltage[i];
    }
}

// Whether the arm is touched. Law: the contact's where any lane runs it.
template <fl_law_t Law>
[[gnu::flatten]] void touch_lanes(LawBatch &__restrict b, LawScratch &__restrict s,
                                  const ContactLanes *__restrict c) {
    for (int i = 0; i < lane_group_size; ++i) {
        const fl_drive_config_t config = drive_config_of<FL_LAW_PAPER>(b, nullptr, i);
        fl_drive_state_t state = drive_state_of<FL_LAW_PAPER>(b, nullptr, i);
        if (Law == FL_LAW_CONTACT) state.teeth.touching = c->gap.touching[i] & -int32_t{b.law[i] == Law};
        const fl_servo_in_t in = servo_in_of(s, i);
#define X(type, name) b.torque.name[i],
        const fl_servo_out_t torque = {FL_LAW_TORQUE(X)};
#undef X
        const fl_sincos_t rotor = {s.rotor_sin[i], s.rotor_cos[i]};
        s.stuck[i] = int32_t{fl_drive_touched(&config, &state, &in, &torque, b.voltage[i], rotor)};
#define X(type, name) b.observer.name[i] = state.touch.name;
        FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) b.ripple.name[i] = state.touch.ripple.name;
        FL_LAW_RIPPLE(X)
#undef X
    }
}

// The other watch, and the phases.
[[gnu::flatten]] void phase_lanes(LawBatch &__restrict b, LawScratch &__restrict s) {
    for (int i = 0; i < lane_group_size; ++i) {
        const fl_drive_config_t config = drive_config_of<FL_LAW_PAPER>(b, nullptr, i);
        const fl_drive_state_t state = drive_state_of<FL_LAW_PAPER>(b, nullptr, i);
        const float speed_rad_s = s.input.speed_rad_s[i];
        const bool collided = fl_drive_collided(&config, &state.servo, b.torque.watched_Nm[i], speed_rad_s);
        s.stuck[i] |= int32_t{collided};
        const fl_duty_t duty = fl_drive_phases(b.voltage[i], {s.rotor_sin[i], s.rotor_cos[i]}, speed_rad_s);
        s.duty_a[i] = duty.phase[0];
        s.duty_b[i] = duty.phase[1];
        s.duty_c[i] = duty.phase[2];
    }
}

// laws: a bit of 1 << law for each that a lane wants.
void drive_law(LawBatch &b, LawScratch &s, unsigned laws) {
    constexpr unsigned paper = 1U << FL_LAW_PAPER, contact = 1U << FL_LAW_CONTACT;
    if (laws == paper) {
        torque_lanes<FL_LAW_PAPER, false>(b, s, nullptr);
    } else if (laws == contact) {
        torque_lanes<FL_LAW_CONTACT, false>(b, s, b.contact);
    } else {
        torque_lanes<FL_LAW_PAPER, true>(b, s, b.contact);
        torque_lanes<FL_LAW_CONTACT, true>(b, s, b.contact);
    }
    if ((laws & contact) != 0)
        touch_lanes<FL_LAW_CONTACT>(b, s, b.contact);
    else
        touch_lanes<FL_LAW_PAPER>(b, s, nullptr);
    phase_lanes(b, s);
}

} // namespace
} // namespace fl::twin
