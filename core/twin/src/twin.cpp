#include "fiberloom/twin/twin.hpp"

#include <algorithm>
#include <utility>

#include "plane/twin_state.hpp"

namespace fl::twin {

Twin::Twin(const TwinSetup &setup) : s_(std::make_unique<State>(setup)) {}
Twin::~Twin() = default;

size_t Twin::positioner_count() const { return s_->count; }
uint64_t Twin::tick() const { return s_->now; }
Plant &Twin::plant() { return s_->plant; }
const Neighbours &Twin::neighbours() const { return s_->neighbours; }
const char *Twin::kernel_name() const { return s_->plant.kernel_name(); }

void Twin::send(const fl_can_frame_t &frame, int bus) {
    const uint32_t id = frame.id >> 18 & 0x7ff;
    if (id == 0) {
        for (size_t i = 0; i < s_->count; ++i) {
            if (i + 1 < s_->count) s_->positioners[i + 1].fetch();
            s_->hear(i, frame, bus);
        }
        if ((frame.id >> 10 & 0xff) == start_command) s_->started = true;
    } else if (id < s_->index_of_id.size() && s_->index_of_id[id] != no_index) {
        s_->hear(s_->index_of_id[id], frame, bus);
    }
}

void Twin::connect(size_t i, int bus) { s_->at(i).bus = bus; }

void Twin::prepare() { s_->prepare(); }

std::vector<Reply> Twin::run(uint64_t ticks) { return run_until_reply(ticks, 1); }

std::vector<Reply> Twin::run_until_reply(uint64_t ticks, uint64_t slices) {
    std::vector<Reply> replies;
    for (; slices > 0 && replies.empty(); --slices) {
        s_->pass(ticks);
        replies = s_->collect();
    }
    s_->workers.rest();
    return replies;
}

Angles Twin::output(size_t i) const {
    s_->check(i);
    return {s_->plant.output_rad(2 * i), s_->plant.output_rad(2 * i + 1)};
}

const fl_positioner_t &Twin::firmware(size_t i) const { return s_->at(i).firmware(); }
bool Twin::asleep(size_t i) const {
    s_->check(i);
    return s_->positioners[i].asleep();
}
bool Twin::resting() const { return s_->quiet && !s_->any_awake(); }

size_t Twin::single_ticks() const {
    size_t sum = 0;
    for (const LaneGroup &group : s_->lane_groups) sum += group.single_ticks();
    return sum;
}

uint64_t Twin::ticks_skipped() const {
    uint64_t sum = 0;
    for (const PositionerGroup &group : s_->groups) sum += group.skipped;
    return sum;
}

uint64_t Twin::ticks_run() const {
    uint64_t sum = 0;
    for (size_t i = 0; i < s_->count; ++i) s_->release(i);
    for (const PositionerGroup &group : s_->groups) sum += group.ticks_run;
    return sum;
}

uint64_t Twin::group_ticks() const {
    uint64_t sum = 0;
    for (const PositionerGroup &group : s_->groups) sum += group.stepped;
    return sum;
}

uint64_t Twin::slices() const { return s_->slices; }

std::vector<double> Twin::bounds_mm(uint64_t ticks) const {
    std::vector<double> bounds;
    for (size_t i = 0; i < s_->count; ++i)
        bounds.push_back(s_->neighbours.bound_mm(i, {0.0, s_->speed_mm(i)}, ticks));
    return bounds;
}

// The firmware's own state is a board's business.
size_t Twin::bytes_per_positioner() const {
    const auto held = [](const auto &list) { return list.capacity() * sizeof(list[0]); };
    size_t bytes = sizeof(State) + s_->plant.bytes() + s_->neighbours.bytes() + held(s_->lane_groups);
    for (size_t i = 0; i < s_->count; ++i) bytes += s_->positioners[i].bytes();
    for (const LaneGroup &group : s_->lane_groups) bytes += group.bytes();
    for (const PositionerGroup &g : s_->groups) bytes += held(g.outbox.frames) + held(g.outbox.touches);
    bytes += held(s_->groups) + held(s_->seen) + held(s_->next) + held(s_->travels) + held(s_->next_travels) +
             held(s_->gears_rad) + held(s_->felt) + held(s_->pushed);
    bytes += held(s_->scoped) + held(s_->closely) + held(s_->turns) + held(s_->index_of_id);
    return s_->count == 0 ? 0 : (bytes + s_->count - 1) / s_->count;
}

void Twin::set_external_torque(size_t i, int axis, double torque_Nm) {
    Positioner &p = s_->at(i);
    p.touch_now().user_push.torque_Nm[axis] = torque_Nm;
    s_->bend(i);
    if (p.touch().over()) p.touching.reset();
}

void Twin::set_loads(size_t i, const AxisLoad &alpha, const AxisLoad &beta) {
    Positioner &p = s_->at(i);
    const Arm &arm = s_->neighbours.arm(i);
    const Angles zero = {arm.alpha_off_rad, arm.beta_off_rad};
    p.loads = std::make_unique<ArmLoads>(alpha, beta, zero, s_->at_rest(i));
    s_->loaded = true;
    s_->bend(i);
}

void Twin::point(Gravity gravity) {
    s_->gravity = gravity;
    for (size_t i = 0; i < s_->count; ++i)
        if (s_->positioners[i].loads) s_->bend(i);
}
void Twin::set_temperature(size_t i, uint32_t counts) { s_->at(i).temperature_cnt = counts; }

void Twin::set_faults(size_t i, const PositionerFaults &faults) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.set_faults(faults);
    for (size_t axis = 0; axis < FL_AXES; ++axis) s_->plant.set_faults(2 * i + axis, faults.axes[axis]);
    s_->learn(i);
}

const PositionerFaults &Twin::faults(size_t i) const { return s_->at(i).faults(); }

void Twin::set_transmission(size_t i, int axis, const Transmission &transmission) {
    s_->at(i).wake(s_->now);
    s_->plant.set_transmission(2 * i + static_cast<size_t>(axis), transmission);
    s_->learn(i);
}

void Twin::set_params(size_t i, int axis, const PlantParams &params) {
    s_->at(i).wake(s_->now);
    s_->plant.set_params(2 * i + static_cast<size_t>(axis), params);
    s_->learn(i);
}

void Twin::power_cycle(size_t i, bool bootloader) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.power_cycle();
    if (bootloader) fl_positioner_enter_bootloader(&p.firmware());
}

void Twin::power_up(size_t i, int alpha_turns, int beta_turns) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    const int turns[FL_AXES] = {alpha_turns, beta_turns};
    p.power_up(turns);
}

void Twin::scope(size_t i, int axis, bool on) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.start_scope(axis, on);
    const uint32_t bit = 1U << s_->place(i).lane;
    uint32_t &scoped = s_->scoped[s_->place(i).group];
    scoped = p.scoped() ? scoped | bit : scoped & ~bit;
}

std::vector<ScopeSample> Twin::take_scope(size_t i, int axis) { return s_->at(i).take_scope(axis); }

std::vector<Touch> Twin::take_touches() {
    std::vector<Touch> all;
    for (PositionerGroup &group : s_->groups) {
        all.insert(all.end(), group.outbox.touches.begin(), group.outbox.touches.end());
        group.outbox.touches.clear();
    }
    std::stable_sort(all.begin(), all.end(), [](const Touch &a, const Touch &b) {
        return a.tick != b.tick ? a.tick < b.tick : a.first < b.first;
    });
    return all;
}

} // namespace fl::twin
