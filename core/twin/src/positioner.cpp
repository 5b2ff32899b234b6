#include "positioner.hpp"

#include <algorithm>
#include <cstddef>
#include <numbers>
#include <utility>

#include "fl_dispatch.h"
#include "fl_identifier.h"
#include "fl_storage.h"

namespace fl::twin {

void Positioner::attach(PositionerGroup &group, size_t index, size_t lane) {
    move(group, lane);
    index_ = static_cast<uint16_t>(index);
    group_->awake |= 1U << lane_;
}

fl_port_t Positioner::port() {
    return {this,         read_hall,     set_phases,       send_frame,
            storage_read, storage_write, read_temperature, open_phases};
}

const PositionerFaults Positioner::sound;
const Touching Positioner::untouched;

void Positioner::boot(uint16_t id, const FactoryParams::Both &first, const fl_axis_params_t params[FL_AXES]) {
    factory_.set(first, {params[FL_ALPHA], params[FL_BETA]});
    start(id);
}

void Positioner::start(uint16_t id) {
    const fl_port_t hardware = port();
    fl_positioner_init(&firmware_, &hardware, id, factory_.both().data());
}

void Positioner::deliver(const int32_t position_cnt[FL_AXES], const int32_t stop_cnt[FL_AXES]) {
    for (int axis = 0; axis < FL_AXES; ++axis) {
        fl_axis_t &a = firmware_.axis[axis];
        a.offset_cnt = stop_cnt[axis] - a.law.datum_cnt;
    }
    fl_positioner_set_position(&firmware_, position_cnt);
    fl_storage_save(&firmware_);
    storage_.share(factory_);
}

void Positioner::power_cycle() {
    const uint16_t id = firmware_.id;
    const float off[3] = {0.0f, 0.0f, 0.0f};
    for (int axis = 0; axis < FL_AXES; ++axis) set_phases(this, axis, off);
    start(id);
}

void Positioner::power_up(const int turns[FL_AXES]) {
    for (int axis = 0; axis < FL_AXES; ++axis) firmware_.axis[axis].position_cnt += turns[axis] * FL_TURN_CNT;
    firmware_.datum_known = 0;
    fl_storage_note_position(&firmware_, false);
    power_cycle();
}

void Positioner::receive(const fl_can_frame_t &frame, uint64_t tick) {
    if (faults().deaf) return;
    wake(tick);
    if (!spoils_start(frame)) fl_positioner_receive(&firmware_, &frame);
}

bool Positioner::spoils_start(const fl_can_frame_t &frame) {
    fl_identifier_t id = fl_identifier_unpack(frame.id);
    const bool spoilt = faults().at_start != AtStart::obeys && id.command == start_command &&
                        firmware_.state == FL_STATE_LOADED;
    if (!spoilt) return false;
    const AtStart what = std::exchange(faults_->at_start, AtStart::obeys);
    if (what == AtStart::refuses) {
        id.positioner = firmware_.id;
        id.code = FL_INVALID_COMMAND;
        fl_can_frame_t reply{};
        reply.id = fl_identifier_pack(id);
        send_frame(this, &reply);
    } else if (what == AtStart::restarts) {
        power_cycle();
        fl_positioner_enter_bootloader(&firmware_);
    }
    return true;
}

// A tick that left both axes as they were: the next ones will, too, under the same duties.
bool Positioner::still() const {
    return group_->lanes->still[lane(FL_ALPHA)] != 0 && group_->lanes->still[lane(FL_BETA)] != 0;
}

// Between two ticks in which they are told where the arms are, those may have moved on.
bool Positioner::loads_follow(const Plant &plant) const {
    return !loads || loads->follow({plant.output_at_rest_rad(number(FL_ALPHA)),
                                    plant.output_at_rest_rad(number(FL_BETA))});
}

void Positioner::rest(const Plant &plant, uint64_t tick, bool may_sleep) {
    if (!may_sleep || !fl_positioner_at_rest(&firmware_)) return;
    if (!still() || scoped() || !loads_follow(plant)) return;
    group_->awake &= ~(1U << lane_);
    asleep_since_ = tick;
}

void Positioner::wake(uint64_t tick) {
    group_->now = tick;
    if (!asleep()) return;
    group_->awake |= 1U << lane_;
    const uint64_t ticks = tick - asleep_since_;
    group_->skipped += ticks;
    if (ticks > 0) fl_positioner_skip(&firmware_, static_cast<uint32_t>(ticks));
}

void Positioner::fetch() const {
    constexpr size_t line = 64;
    for (const fl_axis_t &a : firmware_.axis)
        for (size_t at = 0; at < offsetof(fl_axis_t, fit); at += line)
            __builtin_prefetch(reinterpret_cast<const char *>(&a) + at, 1);
}

void Positioner::start_scope(int axis, bool on) {
    if (on && !scope_) scope_ = std::make_unique<std::array<std::vector<ScopeSample>, FL_AXES>>();
    scope_on_[axis] = on;
}

std::vector<ScopeSample> Positioner::take_scope(int axis) {
    if (!scope_) return {};
    return std::exchange((*scope_)[static_cast<size_t>(axis)], {});
}

void Positioner::record(const Plant &plant, uint64_t tick) {
    for (int axis = 0; axis < FL_AXES; ++axis)
        if (scope_on_[axis]) (*scope_)[static_cast<size_t>(axis)].push_back(sample(plant, axis, tick));
}

ScopeSample Positioner::sample(const Plant &plant, int axis, uint64_t tick) const {
    const PlantParams params = plant.params(number(axis));
    const AxisGroup &lanes = *group_->lanes;
    const size_t at = lane(axis);
    const AxisState state = plant.state(number(axis));
    const fl_axis_telemetry_t t = fl_positioner_telemetry(&firmware_, axis);
    ScopeSample s{};
    s.time_s = tick_s * static_cast<double>(tick + 1);
    s.motor_rad = state.theta_rad;
    s.gear_rad = state.gear_rad;
    s.output_rad = state.output_rad;
    s.speed_rad_s = state.momentum_Nms / (params.inertia_motor + params.inertia_gear);
    s.torque_out_Nm = plant.external_torque_Nm(number(axis));
    s.duty_a = static_cast<double>(lanes.duty[0][at]);
    s.duty_b = static_cast<double>(lanes.duty[1][at]);
    s.duty_c = static_cast<double>(lanes.duty[2][at]);
    s.hall_a_cnt = lanes.hall_cnt[0][at];
    s.hall_b_cnt = lanes.hall_cnt[1][at];
    s.command_deg = static_cast<double>(t.command_deg);
    s.tracking_deg = static_cast<double>(t.tracking_deg);
    s.command_speed_rad_s = static_cast<double>(t.speed_rad_s);
    s.feedback_Nm = static_cast<double>(t.feedback_Nm);
    s.feedforward_Nm = static_cast<double>(t.feedforward_Nm);
    s.voltage = static_cast<double>(t.voltage);
    s.load_Nm = static_cast<double>(t.load_Nm);
    s.touch_Nm = static_cast<double>(t.touch_Nm);
    return s;
}

void Positioner::hall(int axis, uint16_t adc_cnt[2]) {
    uint16_t *last = last_hall_[axis];
    if (!faults().stuck_hall[axis])
        for (int k = 0; k < 2; ++k) last[k] = static_cast<uint16_t>(group_->lanes->hall_cnt[k][lane(axis)]);
    adc_cnt[0] = last[0];
    adc_cnt[1] = last[1];
}

// Between ticks the channels show what they will in the next one: of an axis that rests they may be of any
// tick before, whichever others share its lanes.
void Positioner::look() {
    if (group_->sensed == group_->now) return;
    const uint64_t lanes = uint64_t{1} << lane(FL_ALPHA) | uint64_t{1} << lane(FL_BETA);
    group_->plant->sense(group_->plant->place(number(FL_ALPHA)).group, static_cast<uint32_t>(group_->now),
                         lanes);
}

void Positioner::read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    auto &p = *static_cast<Positioner *>(ctx);
    p.look();
    p.hall(axis, adc_cnt);
}

void Positioner::set_phases(void *ctx, int axis, const float duty[3]) {
    auto &p = *static_cast<Positioner *>(ctx);
    for (int k = 0; k < 3; ++k) p.group_->lanes->duty[k][p.lane(axis)] = duty[k];
    p.group_->plant->set_open(p.number(axis), false);
}

void Positioner::open_phases(void *ctx, int axis) {
    const auto &p = *static_cast<Positioner *>(ctx);
    p.group_->plant->set_open(p.number(axis), true);
}

bool Positioner::send_frame(void *ctx, const fl_can_frame_t *frame) {
    auto &p = *static_cast<Positioner *>(ctx);
    if (!p.faults().mute) p.group_->outbox.frames.push_back({{p.group_->now, *frame}, p.index_});
    return true;
}

uint32_t Positioner::read_temperature(void *ctx) { return static_cast<Positioner *>(ctx)->temperature_cnt; }

uint32_t Positioner::storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    const auto &p = *static_cast<Positioner *>(ctx);
    if (offset >= storage_bytes) return 0;
    const uint32_t held = std::min(len, static_cast<uint32_t>(storage_bytes) - offset);
    p.storage_.read(offset, static_cast<uint8_t *>(bytes), held);
    return held;
}

uint32_t Positioner::storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    auto &p = *static_cast<Positioner *>(ctx);
    if (offset >= storage_bytes) return 0;
    const uint32_t held = std::min(len, static_cast<uint32_t>(storage_bytes) - offset);
    p.storage_.write(offset, static_cast<const uint8_t *>(bytes), held);
    return held;
}

} // namespace fl::twin
