// What a twin is: positioners in groups, their neighbours and the clock that all share.
#pragma once

#include <algorithm>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "../lane_group.hpp"
#include "fiberloom/twin/twin.hpp"
#include "workers.hpp"

namespace fl::twin {

inline constexpr uint16_t no_index = UINT16_MAX;

// How the arms of positioner i give way and how they can move.
Give give_of(const Plant &plant, size_t i);

struct Twin::State {
    // what the groups of a batch do: show where they are, look at their neighbours, run, or follow them: look
    // and run
    enum class Turn : uint8_t { shows, looks, runs, follows };
    explicit State(const TwinSetup &s);

    void boot(const TwinSetup &s);
    void pass(uint64_t ticks);
    void run_slice(uint64_t most_ticks);
    void run_all(Turn what);
    void look_around(uint64_t most_ticks);
    void run_closely(uint64_t ticks);
    void take_turn(size_t group);
    void run_group(size_t group, uint64_t ticks);

    void feel_group(size_t group);
    bool touches(size_t i) const { return felt[i] != 0 && !positioners[i].touch().contacts.empty(); }
    bool in_contact(size_t group) const;
    bool pushes(size_t group);

    void feel_neighbours(size_t i, PositionerGroup &group);
    void note_touches(size_t i, Outbox &outbox);
    void apply_torque(size_t i, const Push &push);
    void bend(size_t i);
    void disturb(size_t i);
    void disturb_all();
    void learn(size_t i);
    Angles loose(size_t i) const;
    void put_torque(size_t i);
    Angles at_rest(size_t i) const;
    void publish(size_t i);
    void show_group(size_t group);
    void travel(size_t group);
    double speed_mm(size_t i) const;
    void show_poses();
    void hear(size_t i, const fl_can_frame_t &frame, int bus);
    bool any_awake() const;
    bool any_felt() const {
        return std::any_of(felt.begin(), felt.end(), [](uint8_t f) { return f != 0; });
    }
    // Which arms might touch is looked at every 2 ms; the forces of those that do follow every tick.
    bool at_sync() const { return now % sync_ticks == 0; }
    uint64_t slice_ticks() const;
    std::span<const uint16_t> members(size_t group) const { return plant.members(group); }
    void follow_loads(size_t group);
    void prepare();
    void rearrange();
    void gather_outboxes();
    std::vector<uint16_t> by_end_of_way() const;
    std::vector<Reply> collect();
    void check(size_t i) const {
        if (i >= count) throw std::out_of_range("positioner " + std::to_string(i) + ": no such index");
    }
    // For whom it may be read or changed: its firmware is up to date.
    Positioner &at(size_t i) {
        check(i);
        release(i);
        return positioners[i];
    }
    // Lane and group of its alpha.
    Plant::Place place(size_t i) const { return plant.place(2 * i); }
    void release(size_t i) { lane_groups[place(i).group].release(static_cast<size_t>(place(i).lane), now); }

    Plant plant;
    size_t count;
    const FactoryParams::Both first_params;    // of the first positioner: others tell what differs
    std::unique_ptr<Positioner[]> positioners; // never moved: their ports point back at them
    std::vector<LaneGroup> lane_groups;        // one per group of the plant
    std::vector<PositionerGroup> groups;       // and what its positioners have in common; never moved
    std::vector<uint16_t> index_of_id;         // up to the largest; or no_index
    Neighbours neighbours;
    bool feel;
    bool skip_resting;
    bool sort_lanes;
    bool started = false; // START was broadcast: lanes are sorted before the next tick
    bool loaded = false;  // something pulls at the arms: it follows them at sync points
    uint64_t now = 0;
    Turn turn = Turn::runs;
    bool tick_by_tick = false;    // the groups that run are those whose arms touch
    uint64_t slice = 0;           // ticks of the slice that runs
    uint64_t slices = 0;          // so far
    uint64_t ahead = 0;           // of this look, see Neighbours::Moment
    std::vector<size_t> turns;    // groups of the batch that runs
    std::vector<size_t> closely;  // and those that are left, whose arms touch: they run tick by tick
    std::vector<uint8_t> felt;    // by positioner: it touches something, or has just done so
    std::vector<uint8_t> pushed;  // by positioner: the force on it may change from tick to tick in this slice
    std::vector<uint32_t> scoped; // by group: who has a scope on, a bit each
    bool quiet = false;           // a sync point has passed with every positioner asleep: time alone goes on
    // where the arms are: as of the last sync point (read), and of the next (written)
    std::vector<Pose> seen, next;
    // how each has travelled by then, and where its gears were
    std::vector<Travel> travels, next_travels;
    std::vector<double> gears_rad; // by axis
    Gravity gravity;
    Workers workers;
};

} // namespace fl::twin
