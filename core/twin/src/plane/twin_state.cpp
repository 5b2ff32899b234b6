#include "twin_state.hpp"

#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

namespace fl::twin {
namespace {

constexpr uint64_t lone_ticks = 32; // of a slice where nothing meets: what a group needs stays in the cache
constexpr double two_pi = 2.0 * std::numbers::pi;
constexpr double counts_per_turn = 1073741824.0; // 2^30 per output turn on the wire

std::vector<double> flat(const std::vector<Angles> &angles) {
    std::vector<double> out;
    for (const Angles &a : angles) out.insert(out.end(), {a.alpha_rad, a.beta_rad});
    return out;
}

void check_sizes(const TwinSetup &s) {
    const size_t n = s.ids.size();
    if (s.units.size() != 2 * n || s.params.size() != 2 * n || s.start.size() != n || s.arms.size() != n)
        throw std::invalid_argument("ids, arms and start need N rows, units and params 2 N");
    if (s.threads < 1 || s.threads > 256) throw std::invalid_argument("threads: 1 to 256");
    for (uint16_t id : s.ids)
        if (id < 1 || id > 2047) throw std::invalid_argument("positioner ids: 1 to 2047");
}

size_t id_count(const TwinSetup &s) {
    return s.ids.empty() ? 0 : size_t{*std::max_element(s.ids.begin(), s.ids.end())} + 1;
}

FactoryParams::Both params_of_first(const TwinSetup &s) {
    FactoryParams::Both both{};
    if (!s.params.empty()) std::copy_n(s.params.begin(), FL_AXES, both.begin());
    return both;
}

std::vector<Give> gives_of(const Plant &plant) {
    std::vector<Give> gives;
    for (size_t i = 0; i < plant.axis_count() / 2; ++i) gives.push_back(give_of(plant, i));
    return gives;
}

// Where a datum search ends the rotor has wound up the gear by 0.5 to 1.5 turns beyond the first touch; the
// rotor's angle tells the rest. tests/twin/faults/test_faults.py searches datums against it.
constexpr double wound_rad = two_pi;

int32_t wire_count(double motor_rad, double gear_ratio) {
    return static_cast<int32_t>(std::lround(motor_rad / (two_pi * gear_ratio) * counts_per_turn));
}

} // namespace

Twin::State::State(const TwinSetup &s)
    : plant((check_sizes(s), s.units), flat(s.start), s.seed, s.kernel.c_str(), s.substeps),
      count(s.ids.size()), first_params(params_of_first(s)),
      positioners(std::make_unique<Positioner[]>(count)), lane_groups(plant.group_count()),
      groups(plant.group_count()), index_of_id(id_count(s), no_index),
      neighbours(s.arms, s.obstacles, s.body, gives_of(plant), s.bound_scale), feel(s.neighbours),
      skip_resting(s.skip_resting), sort_lanes(s.sort_lanes), felt(s.ids.size()), pushed(s.ids.size()),
      scoped(plant.group_count()), seen(s.ids.size()), next(s.ids.size()), travels(s.ids.size()),
      next_travels(s.ids.size()), gears_rad(plant.axis_count()),
      workers(s.threads, [this](size_t at) { take_turn(turns[at]); }) {
    boot(s);
    for (size_t axis = 0; axis < plant.axis_count(); ++axis) gears_rad[axis] = plant.gear_rad(axis);
    for (size_t i = 0; i < count; ++i) publish(i);
    seen = next;
    for (size_t i = 0; i < count; ++i) neighbours.allow_loose(i, loose(i));
    if (feel) neighbours.plan_first_looks(seen);
}

void Twin::State::boot(const TwinSetup &s) {
    for (size_t g = 0; g < plant.group_count(); ++g) {
        groups[g].plant = &plant;
        groups[g].lanes = &plant.group(g);
    }
    for (size_t i = 0; i < s.ids.size(); ++i) {
        uint16_t &index = index_of_id[s.ids[i]];
        if (index != no_index)
            throw std::invalid_argument("positioner id " + std::to_string(s.ids[i]) + " occurs twice");
        index = static_cast<uint16_t>(i);
        Positioner &p = positioners[i];
        p.attach(groups[place(i).group], i, static_cast<size_t>(place(i).lane));
        p.boot(s.ids[i], first_params, &s.params[2 * i]);
    }
    for (size_t g = 0; g < plant.group_count(); ++g)
        lane_groups[g].attach(plant, g, positioners.get(), groups[g], s.side_by_side);
    for (size_t i = 0; i < s.ids.size(); ++i) {
        int32_t position[FL_AXES], stop[FL_AXES];
        for (size_t axis = 0; axis < FL_AXES; ++axis) {
            const double gear_ratio = plant.params(2 * i + axis).gear_ratio;
            position[axis] = wire_count(plant.motor_rad(2 * i + axis), gear_ratio);
            stop[axis] = wire_count(plant.lower_stop_rad(2 * i + axis) - wound_rad, gear_ratio);
        }
        positioners[i].deliver(position, stop);
    }
}

// A task of a batch. To look reads `seen`.
void Twin::State::take_turn(size_t group) {
    if (turn == Turn::shows) show_group(group);
    if (turn == Turn::looks || turn == Turn::follows) feel_group(group);
    if (turn == Turn::runs || turn == Turn::follows) run_group(group, slice);
}

// Writes `next`, for those whom somebody looks at next.
void Twin::State::run_group(size_t group, uint64_t ticks) {
    LaneGroup &lane_group = lane_groups[group];
    if (!lane_group.gather()) return;
    LawScratch scratch{};
    for (uint64_t tick = now; tick < now + ticks; ++tick) {
        const uint64_t used = scoped[group] != 0 ? every_lane : lane_group.used();
        plant.sense(group, static_cast<uint32_t>(tick), used);
        groups[group].sensed = tick;
        lane_group.tick(tick, scratch);
        plant.step(group, used);
        for (uint32_t left = scoped[group]; left != 0; left &= left - 1)
            positioners[members(group)[static_cast<size_t>(std::countr_zero(left))]].record(plant, tick);
        if (loaded && (tick + 1) % load_ticks == 0) follow_loads(group);
    }
    groups[group].moved = true;
    groups[group].stepped += ticks;
    lane_group.rest(now + ticks, skip_resting);
    if (!tick_by_tick) return;
    for (const size_t i : members(group))
        if (neighbours.shown(i, now + ticks)) publish(i);
}

bool Twin::State::any_awake() const {
    return std::any_of(groups.begin(), groups.end(), [](const PositionerGroup &g) { return g.awake != 0; });
}

// To the next sync point; to one further on where no arm can touch another before.
uint64_t Twin::State::slice_ticks() const {
    if (!feel) return lone_ticks;
    const uint64_t to_sync = sync_ticks - now % sync_ticks;
    if (any_felt()) return to_sync;
    const uint64_t due = neighbours.next_due();
    return std::clamp(due - std::min(due, now), to_sync, lone_ticks);
}

void Twin::State::run_all(Turn what) {
    turns.resize(groups.size());
    std::iota(turns.begin(), turns.end(), size_t{0});
    turn = what;
    workers.run(turns.size());
}

// Who touches whom now; in how many ticks the next two may is known only then. Where none may in a slice of
// so many ticks nobody looks; else all pairs are looked at that are due within the longest slice: calls of
// run() that end slices sooner shall not make looks more frequent.
void Twin::State::look_around(uint64_t most_ticks) {
    const uint64_t end = now + std::clamp(most_ticks, sync_ticks, lone_ticks);
    const bool touching = any_felt(), due = at_sync() && neighbours.next_due() < end;
    if (!touching && !due) return;
    ahead = touching ? 0 : lone_ticks - sync_ticks;
    if (at_sync()) {
        run_all(Turn::shows);
        show_poses();
    }
    run_all(Turn::looks);
    for (size_t group = 0; group < groups.size(); ++group)
        for (uint32_t left = std::exchange(groups[group].disturbed, 0); left != 0; left &= left - 1)
            neighbours.disturb(members(group)[static_cast<size_t>(std::countr_zero(left))],
                               now - now % sync_ticks + sync_ticks);
}

void Twin::State::pass(uint64_t ticks) {
    prepare();
    const uint64_t end = now + ticks;
    while (now < end) {
        const bool resting = !any_awake(), in_sync = !feel || at_sync();
        if (resting && quiet) {
            now = end;
            break;
        }
        run_slice(end - now);
        quiet = resting && in_sync && !any_awake();
    }
}

void Twin::State::run_slice(uint64_t most_ticks) {
    if (feel) look_around(most_ticks);
    slice = std::min(slice_ticks(), most_ticks);
    ++slices;
    turns.clear();
    closely.clear();
    for (size_t group = 0; group < groups.size(); ++group) {
        if (in_contact(group) && pushes(group))
            closely.push_back(group);
        else if (groups[group].awake != 0)
            turns.push_back(group);
        else
            lane_groups[group].skip();
    }
    turn = Turn::runs;
    workers.run(turns.size());
    if (closely.empty())
        now += slice;
    else
        run_closely(std::exchange(slice, 1));
}

// The groups that are left, tick by tick: forces may change in each.
void Twin::State::run_closely(uint64_t ticks) {
    turns.swap(closely);
    tick_by_tick = true;
    for (uint64_t k = 0; k < ticks; ++k, turn = Turn::follows) {
        workers.run(turns.size());
        ++now;
        for (const size_t group : turns)
            for (const size_t i : members(group)) seen[i] = next[i];
    }
    tick_by_tick = false;
}

std::vector<Reply> Twin::State::collect() {
    std::vector<Sent> all;
    for (PositionerGroup &group : groups) {
        Outbox &box = group.outbox;
        all.insert(all.end(), box.frames.begin(), box.frames.end());
        if (!box.frames.empty()) box.frames = std::vector<Sent>(); // few ticks have replies
    }
    std::stable_sort(all.begin(), all.end(), [](const Sent &a, const Sent &b) {
        return a.reply.tick != b.reply.tick ? a.reply.tick < b.reply.tick : a.sender < b.sender;
    });
    std::vector<Reply> replies;
    for (const Sent &sent : all) replies.push_back(sent.reply);
    return replies;
}

void Twin::State::hear(size_t i, const fl_can_frame_t &frame, int bus) {
    if (bus != every_bus && positioners[i].bus != bus) return;
    release(i);
    positioners[i].receive(frame, now);
}

} // namespace fl::twin
