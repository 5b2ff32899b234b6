#include "lane_group.hpp"

#include <algorithm>
#include <cstddef>

namespace fl::twin {
namespace {

// The lane_group's turn comes every few ticks, after all others': what its firmware touches is asked for at
// once, not piece by piece.
void fetch(const fl_positioner_t &firmware) {
    constexpr size_t line = 64;
    for (const fl_axis_t &a : firmware.axis)
        for (size_t at = 0; at < offsetof(fl_axis_t, fit); at += line)
            __builtin_prefetch(reinterpret_cast<const char *>(&a) + at, 1);
}

void load_law(LawBatch &b, int i, const fl_axis_law_t &law) {
#define X(type, name) b.hall.name[i] = law.hall.name;
    FL_LAW_HALL(X)
#undef X
#define X(type, name) b.servo.name[i] = law.drive.servo.name;
    FL_LAW_SERVO(X)
#undef X
#define X(type, name) b.collision.name[i] = law.drive.collision.name;
    FL_LAW_COLLISION(X)
#undef X
#define X(type, name) b.touch.name[i] = law.drive.touch.name;
    FL_LAW_TOUCH(X)
#undef X
#define X(type, name) b.teeth.name[i] = law.drive.teeth.name;
    FL_LAW_TEETH(X)
#undef X
#define X(type, name) b.regulator.name[i] = law.drive.regulator.name;
    FL_LAW_REGULATOR(X)
#undef X
    b.law[i] = law.drive.law;
    b.voltage_per_Nm[i] = law.drive.voltage_per_Nm;
    b.full_Nm[i] = law.drive.full_Nm;
}

void load_input(LawBatch &b, int i, const fl_servo_in_t &in, const fl_drive_state_t &state) {
#define X(type, name) b.input.name[i] = in.name;
    FL_LAW_INPUT(X)
#undef X
#define X(type, name) b.state.name[i] = state.servo.name;
    FL_LAW_STATE(X)
#undef X
#define X(type, name) b.observer.name[i] = state.touch.name;
    FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) b.ripple.name[i] = state.touch.ripple.name;
    FL_LAW_RIPPLE(X)
#undef X
#define X(type, name) b.gap.name[i] = state.teeth.name;
    FL_LAW_GAP(X)
#undef X
#define X(type, name) b.seen.name[i] = state.regulator.seen.name;
    FL_LAW_SEEN(X)
#undef X
    b.slack_Nm[i] = state.regulator.slack_Nm;
}

void take_output(const LawBatch &b, int i, fl_axis_t &a) {
#define X(type, name) a.drive.servo.name = b.state.name[i];
    FL_LAW_STATE(X)
#undef X
#define X(type, name) a.drive.touch.name = b.observer.name[i];
    FL_LAW_OBSERVER(X)
#undef X
#define X(type, name) a.drive.touch.ripple.name = b.ripple.name[i];
    FL_LAW_RIPPLE(X)
#undef X
#define X(type, name) a.drive.teeth.name = b.gap.name[i];
    FL_LAW_GAP(X)
#undef X
#define X(type, name) a.drive.regulator.seen.name = b.seen.name[i];
    FL_LAW_SEEN(X)
#undef X
#define X(type, name) a.torque.name = b.torque.name[i];
    FL_LAW_TORQUE(X)
#undef X
    a.drive.regulator.slack_Nm = b.slack_Nm[i];
    a.voltage = b.voltage[i];
}

} // namespace

void LaneGroup::attach(Plant &plant, size_t group, Positioner *positioners, size_t count, bool side_by_side) {
    plant_ = &plant;
    group_ = &plant.group(group);
    positioners_ = positioners;
    count_ = count;
    side_by_side_ = side_by_side;
}

bool LaneGroup::gather() {
    bool any = false;
    for (size_t i = 0; i < count_; ++i) {
        awake_[i] = !positioners_[i].asleep();
        any |= awake_[i];
        if (awake_[i]) fetch(positioners_[i].firmware());
    }
    for (auto &axis : loaded_) axis.fill(false); // what came over the bus may have changed parameters
    return any;
}

void LaneGroup::tick(uint64_t tick) {
    for (size_t i = 0; i < count_; ++i) runs_[i] = awake_[i] && positioners_[i].begin_tick(tick);
    for (int axis = 0; axis < FL_AXES; ++axis) tick_axis(axis);
}

void LaneGroup::rest(uint64_t tick, bool may_sleep) {
    for (size_t i = 0; i < count_; ++i)
        if (awake_[i]) positioners_[i].rest(*plant_, tick, may_sleep);
}

// All of one axis before the other, as within a positioner: a collision of alpha stops beta in the same tick.
void LaneGroup::tick_axis(int axis) {
    LawBatch &batch = batches_[static_cast<size_t>(axis)];
    size_t count = 0;
    for (size_t i = 0; i < count_; ++i)
        if (runs_[i] && ask(axis, positioners_[i], static_cast<int>(i), batch))
            trackers_[count++] = {&positioners_[i], static_cast<int>(i), {}};
    if (count == 0) return;
    plant_->kernel().hall_law(batch);
    unsigned laws = 0;
    for (size_t k = 0; k < count; ++k) {
        advance(axis, trackers_[k], batch);
        laws |= 1U << batch.law[trackers_[k].lane];
    }
    plant_->kernel().drive_law(batch, laws);
    for (size_t k = 0; k < count; ++k) conclude(axis, trackers_[k], batch);
}

// An axis that tracks gives its hall counts to the batch. Any other does its tick alone.
bool LaneGroup::ask(int axis, Positioner &p, int lane, LawBatch &b) {
    fl_positioner_t &firmware = p.firmware();
    fl_axis_t &a = firmware.axis[axis];
    bool &loaded = loaded_[static_cast<size_t>(axis)][static_cast<size_t>(lane)];
    if (!fl_axis_tracks(&a) || !side_by_side_) {
        loaded = false;
        if (!fl_axis_rests(&a))
            fl_positioner_end_axis(&firmware, axis,
                                   fl_axis_tick(&a, &firmware.path[axis], &firmware.port, axis));
        return false;
    }
    if (!loaded) load_law(b, lane, a.law);
    loaded = true;
    p.hall(axis, a.adc_cnt);
    b.adc_a_cnt[lane] = a.adc_cnt[0];
    b.adc_b_cnt[lane] = a.adc_cnt[1];
    b.angle_cnt[lane] = a.hall.angle_cnt;
    return true;
}

void LaneGroup::advance(int axis, Tracker &t, LawBatch &b) {
    fl_positioner_t &firmware = t.positioner->firmware();
    fl_axis_t &a = firmware.axis[axis];
    a.hall.angle_cnt = b.angle_cnt[t.lane];
    fl_axis_advance(&a, &firmware.path[axis], &t.demand);
    load_input(b, t.lane, t.demand.servo, a.drive);
}

void LaneGroup::conclude(int axis, const Tracker &t, const LawBatch &b) {
    fl_positioner_t &firmware = t.positioner->firmware();
    fl_axis_t &a = firmware.axis[axis];
    const int i = t.lane;
    take_output(b, i, a);
    const bool stops = b.stuck[i] != 0 && a.detect;
    if (!stops) {
        const int lane = axis * lane_group_size + i;
        group_->duty[0][lane] = b.duty_a[i];
        group_->duty[1][lane] = b.duty_b[i];
        group_->duty[2][lane] = b.duty_c[i];
    }
    const fl_axis_event_t event = fl_axis_conclude(&a, &firmware.port, axis, t.demand.way_ended, stops);
    if (event != FL_AXIS_NONE) fl_positioner_end_axis(&firmware, axis, event);
}

} // namespace fl::twin
