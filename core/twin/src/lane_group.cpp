#include "lane_group.hpp"

#include <algorithm>
#include <bit>
#include <cstddef>

#include "cruise.hpp"

namespace fl::twin {
namespace {

constexpr uint32_t whole_group = UINT32_MAX >> (32 - lane_group_size);

// The bits of a mask, lowest first.
template <typename Do> void each(uint32_t mask, Do &&what) {
    for (; mask != 0; mask &= mask - 1) what(static_cast<size_t>(std::countr_zero(mask)));
}

void load_input(LawScratch &s, int i, const fl_servo_in_t &in) {
#define X(type, name) s.input.name[i] = in.name;
    FL_LAW_INPUT(X)
#undef X
}

// The ticks of this one that would only count, before the host has been silent for too long.
uint32_t quiet_ticks(const fl_positioner_t &p) {
    if (p.trace.decimation != 0 || p.tx.count != 0 || p.chores != 0 || p.state == FL_STATE_BOOTLOADER)
        return 0;
    if (p.host_watch_ticks == 0) return UINT32_MAX;
    const uint32_t silent = p.ticks - p.heard_tick;
    return silent + 1 < p.host_watch_ticks ? p.host_watch_ticks - silent - 1 : 0;
}

// A bit for each flag that is set.
uint32_t lanes_of(const int32_t (&flags)[lane_group_size]) {
    int32_t any = 0;
    for (const int32_t flag : flags) any |= flag;
    uint32_t lanes = 0;
    for (int i = 0; any != 0 && i < lane_group_size; ++i) lanes |= static_cast<uint32_t>(flags[i] != 0) << i;
    return lanes;
}

} // namespace

void LaneGroup::attach(Plant &plant, size_t group, Positioner *positioners, const PositionerGroup &notes,
                       bool side_by_side) {
    plant_ = &plant;
    group_ = &plant.group(group);
    positioners_ = positioners;
    members_ = plant.members(group).data();
    notes_ = &notes;
    side_by_side_ = side_by_side;
}

bool LaneGroup::gather() {
    awake_ = notes_->awake;
    each(awake_ & ~cruise_, [&](size_t i) { in_lane(i).fetch(); });
    return awake_ != 0;
}

void LaneGroup::release(size_t i, uint64_t tick) {
    if ((cruise_ >> i & 1U) != 0) leave(i, tick, {false, false});
    for (auto &axis : loaded_) axis[i] = false; // what comes over the bus may change parameters
}

uint64_t LaneGroup::used() const {
    const uint32_t own = awake_ & ~cruise_;
    const uint64_t beta = own | cruise_axis_[FL_BETA];
    return beta << lane_group_size | own | cruise_axis_[FL_ALPHA];
}

void LaneGroup::tick(uint64_t tick, LawScratch &scratch) {
    if (tick >= next_leave_) take_out_due(tick);
    runs_ = 0;
    each(awake_ & ~cruise_, [&](size_t i) {
        if (in_lane(i).begin_tick(tick)) runs_ |= 1U << i;
    });
    for (int axis = 0; axis < FL_AXES; ++axis) tick_axis(axis, tick, scratch);
    if (side_by_side_) each(runs_, [&](size_t i) { set_out(i, tick + 1); });
}

// Their firmware has not been touched for long: it is asked for while the one before is taken out.
void LaneGroup::take_out_due(uint64_t tick) {
    uint32_t due = 0;
    each(cruise_, [&](size_t i) { due |= static_cast<uint32_t>(since_[i] + ticks_[i] <= tick) << i; });
    if (due == 0) return;
    in_lane(static_cast<size_t>(std::countr_zero(due))).fetch();
    for (uint32_t left = due; left != 0; left &= left - 1) {
        const uint32_t after = left & (left - 1);
        if (after != 0) in_lane(static_cast<size_t>(std::countr_zero(after))).fetch();
        take_out(static_cast<size_t>(std::countr_zero(left)), tick, {false, false});
    }
    find_next();
}

uint32_t LaneGroup::lanes_for(const Positioner &p, size_t i) const {
    // all of a focal plane may begin to land in the same tick; they shall not all come back in one, too
    const uint32_t most = 2 * lane_group_size + static_cast<uint32_t>(i);
    uint32_t ticks = UINT32_MAX;
    for (const fl_axis_t &a : p.firmware().axis)
        if (!fl_axis_rests(&a)) ticks = std::min(ticks, cruise_ticks(a, most));
    if (ticks < least_cruise_ticks || !p.may_cruise()) return 0;
    return std::min(ticks, quiet_ticks(p.firmware()));
}

void LaneGroup::set_out(size_t i, uint64_t tick) {
    const Positioner &p = in_lane(i);
    const fl_axis_t *axes = p.firmware().axis;
    if (fl_axis_rests(&axes[FL_ALPHA]) && fl_axis_rests(&axes[FL_BETA])) return;
    const uint32_t ticks = lanes_for(p, i);
    if (ticks < least_cruise_ticks) return;
    const uint32_t bit = 1U << i;
    for (size_t axis = 0; axis < FL_AXES; ++axis) {
        if (fl_axis_rests(&axes[axis])) continue;
        LawBatch &b = batches_[axis];
        const int lane = static_cast<int>(i);
        if (!loaded_[axis][i]) load(static_cast<int>(axis), lane, axes[axis].law);
        load_state(b, lane, axes[axis].drive);
        load_way(b, lane, axes[axis], tick);
        cruise_axis_[axis] |= bit;
        laws_[axis] |= 1U << b.law[lane];
        if (axes[axis].detect) heeds_[axis] |= bit;
        if (settles(axes[axis])) settles_[axis] |= bit;
    }
    cruise_ |= bit;
    since_[i] = tick;
    ticks_[i] = ticks;
    next_leave_ = std::min(next_leave_, tick + ticks);
}

void LaneGroup::leave(size_t i, uint64_t tick, std::array<bool, FL_AXES> done) {
    take_out(i, tick, done);
    find_next();
}

// What those that are left want, and when the first of them must leave.
void LaneGroup::find_next() {
    for (size_t axis = 0; axis < FL_AXES; ++axis) {
        laws_[axis] = 0;
        each(cruise_axis_[axis], [&](size_t k) { laws_[axis] |= 1U << batches_[axis].law[k]; });
    }
    next_leave_ = UINT64_MAX;
    each(cruise_, [&](size_t k) { next_leave_ = std::min(next_leave_, since_[k] + ticks_[k]); });
}

void LaneGroup::take_out(size_t i, uint64_t tick, std::array<bool, FL_AXES> done) {
    const uint32_t bit = 1U << i;
    Positioner &p = in_lane(i);
    for (size_t axis = 0; axis < FL_AXES; ++axis) {
        if ((cruise_axis_[axis] & bit) == 0) continue;
        LawBatch &b = batches_[axis];
        fl_axis_t &a = p.firmware().axis[axis];
        const int lane = static_cast<int>(i);
        const uint64_t next = tick + (done[axis] ? 1 : 0);
        const auto ticks = static_cast<uint32_t>(next - since_[i]);
        if (ticks != 0) {
            store_state(b, lane, a);
            p.looked(static_cast<int>(axis), b.adc_a_cnt[lane], b.adc_b_cnt[lane], a.adc_cnt);
        }
        store_way(b, lane, a, next, ticks);
        stand(b, lane);
        cruise_axis_[axis] &= ~bit;
        heeds_[axis] &= ~bit;
        settles_[axis] &= ~bit;
    }
    cruise_ &= ~bit;
    const bool within = done[FL_ALPHA] || done[FL_BETA];
    p.count_ticks(static_cast<uint32_t>(tick - since_[i]) + (within ? 1 : 0), tick);
}

void LaneGroup::rest(uint64_t tick, bool may_sleep) {
    each(awake_ & ~cruise_, [&](size_t i) { in_lane(i).rest(*plant_, tick, may_sleep); });
}

// What the hall channels of an axis show, for all that cruise.
void LaneGroup::look(int axis, LawBatch &b) const {
    const int first = axis * lane_group_size;
    std::copy_n(&group_->hall_cnt[0][first], lane_group_size, b.adc_a_cnt);
    std::copy_n(&group_->hall_cnt[1][first], lane_group_size, b.adc_b_cnt);
}

void LaneGroup::set_phases(int axis, uint32_t lanes, const LawScratch &s) {
    const float *duty[] = {s.duty_a, s.duty_b, s.duty_c};
    for (size_t phase = 0; phase < 3; ++phase) {
        float *out = &group_->duty[phase][axis * lane_group_size];
        if (lanes == whole_group)
            std::copy_n(duty[phase], lane_group_size, out);
        else
            each(lanes, [&](size_t i) { out[i] = duty[phase][i]; });
    }
}

// The phases of all that cruise; one that something blocks, or that has settled, does the end of its tick
// itself.
void LaneGroup::drive(int axis, uint64_t tick, LawBatch &b, LawScratch &s) {
    const auto at = static_cast<size_t>(axis);
    const auto end = [&](size_t i) {
        leave(i, tick, {true, axis == FL_BETA});
        runs_ |= 1U << i;
        conclude(axis, {&in_lane(i), static_cast<int>(i), {}}, b, s);
    };
    each(lanes_of(s.stuck) & heeds_[at], end);
    if (settles_[at] != 0) {
        plant_->kernel().settle_law(b, s);
        each(lanes_of(s.settled) & settles_[at], end);
    }
    set_phases(axis, cruise_axis_[at], s);
}

// All of one axis before the other, as within a positioner: a collision of alpha stops beta in the same tick.
void LaneGroup::tick_axis(int axis, uint64_t tick, LawScratch &scratch) {
    LawBatch &batch = batches_[static_cast<size_t>(axis)];
    const uint32_t cruise = cruise_axis_[static_cast<size_t>(axis)];
    if (cruise != 0) look(axis, batch);
    std::array<Tracker, lane_group_size> trackers; // the first `count`
    size_t count = 0;
    each(runs_, [&](size_t i) {
        if (ask(axis, in_lane(i), static_cast<int>(i), batch))
            trackers[count++] = {&in_lane(i), static_cast<int>(i), {}};
    });
    if (count == 0 && cruise == 0) return;
    plant_->kernel().hall_law(batch, scratch);
    if (cruise != 0) plant_->kernel().advance_law(batch, scratch, tick);
    unsigned laws = laws_[static_cast<size_t>(axis)];
    for (size_t k = 0; k < count; ++k) {
        advance(axis, trackers[k], batch, scratch);
        laws |= 1U << batch.law[trackers[k].lane];
    }
    plant_->kernel().drive_law(batch, scratch, laws);
    if (cruise != 0) drive(axis, tick, batch, scratch);
    for (size_t k = 0; k < count; ++k) conclude(axis, trackers[k], batch, scratch);
}

// The configuration of an axis into its lane.
void LaneGroup::load(int axis, int lane, const fl_axis_law_t &law) {
    const auto at = static_cast<size_t>(axis);
    LawBatch &b = batches_[at];
    if (law.drive.law == FL_LAW_CONTACT && !contacts_[at]) {
        contacts_[at] = std::make_unique<ContactLanes>();
        b.contact = contacts_[at].get();
    }
    load_law(b, lane, law);
    loaded_[at][static_cast<size_t>(lane)] = true;
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
    if (!loaded) load(axis, lane, a.law);
    p.hall(axis, a.adc_cnt);
    b.adc_a_cnt[lane] = a.adc_cnt[0];
    b.adc_b_cnt[lane] = a.adc_cnt[1];
    b.angle_cnt[lane] = a.hall.angle_cnt;
    return true;
}

void LaneGroup::advance(int axis, Tracker &t, LawBatch &b, LawScratch &s) {
    fl_positioner_t &firmware = t.positioner->firmware();
    fl_axis_t &a = firmware.axis[axis];
    a.hall.angle_cnt = b.angle_cnt[t.lane];
    fl_axis_advance(&a, &firmware.path[axis], &t.demand);
    load_input(s, t.lane, t.demand.servo);
    load_state(b, t.lane, a.drive);
}

void LaneGroup::conclude(int axis, const Tracker &t, const LawBatch &b, const LawScratch &s) {
    fl_positioner_t &firmware = t.positioner->firmware();
    fl_axis_t &a = firmware.axis[axis];
    const int i = t.lane;
    store_state(b, i, a);
    const bool stops = s.stuck[i] != 0 && a.detect;
    if (!stops) set_phases(axis, 1U << i, s);
    const fl_axis_event_t event = fl_axis_conclude(&a, &firmware.port, axis, t.demand.way_ended, stops);
    if (event != FL_AXIS_NONE) fl_positioner_end_axis(&firmware, axis, event);
}

} // namespace fl::twin
