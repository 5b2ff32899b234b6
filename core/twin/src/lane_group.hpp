// The positioners with axes in one group of the plant: runs their firmware, the laws side by side.
#pragma once

#include <array>
#include <bit>
#include <memory>

#include "fiberloom/twin/law_batch.hpp"
#include "positioner.hpp"

namespace fl::twin {

class LaneGroup {
  public:
    // positioners: all of the plant; notes: of those with axes in this group of it.
    // side_by_side: laws of several axes at once where they track; false: every positioner's own tick, the
    // same bits.
    void attach(Plant &plant, size_t group, Positioner *positioners, const PositionerGroup &notes,
                bool side_by_side);

    // Between slices: notes which positioners are awake. False when none is.
    bool gather();
    // Before `tick`: what the lanes hold of the positioner in lane i goes back to it. Nothing but ticks may
    // read or change its firmware before.
    void release(size_t i, uint64_t tick);
    // A bit for each lane of the plant's group whose firmware may look at its angle or set its duties in the
    // next tick. Of a positioner in the lanes an axis at rest does neither: only a frame gives it a plan.
    uint64_t used() const;
    // scratch: of the thread.
    void tick(uint64_t tick, LawScratch &scratch);
    // After a slice: positioners that have come to rest fall asleep.
    void rest(uint64_t tick, bool may_sleep);

    // Memory beside the object itself.
    size_t bytes() const {
        size_t bytes = 0;
        for (const auto &lanes : contacts_) bytes += lanes ? sizeof *lanes : size_t{0};
        return bytes;
    }

    // Positioners whose own firmware did the last tick of the group.
    size_t single_ticks() const { return static_cast<size_t>(std::popcount(runs_)); }
    // A tick in which none is awake.
    void skip() { runs_ = 0; }

  private:
    // An axis that tracks, and what its firmware asked of the law.
    struct Tracker {
        Positioner *positioner;
        int lane;
        fl_axis_demand_t demand;
    };
    Positioner &in_lane(size_t lane) const { return positioners_[members_[lane]]; }
    void tick_axis(int axis, uint64_t tick, LawScratch &scratch);
    // A positioner whose axes cruise or rest may leave its ticks to the lanes, until the tick `until`.
    void set_out(size_t i, uint64_t tick);
    uint32_t lanes_for(const Positioner &p, size_t i) const;
    // Back again: alpha and beta have done the ticks before `tick`, and that one too if `done` says so.
    void leave(size_t i, uint64_t tick, std::array<bool, FL_AXES> done);
    // The same for one of several: find_next() when all are out.
    void take_out(size_t i, uint64_t tick, std::array<bool, FL_AXES> done);
    void find_next();
    void take_out_due(uint64_t tick);
    void look(int axis, LawBatch &batch) const;
    void drive(int axis, uint64_t tick, LawBatch &batch, LawScratch &scratch);
    void load(int axis, int lane, const fl_axis_law_t &law);
    void set_phases(int axis, uint32_t lanes, const LawScratch &scratch);
    bool ask(int axis, Positioner &p, int lane, LawBatch &batch);
    void advance(int axis, Tracker &t, LawBatch &batch, LawScratch &scratch);
    void conclude(int axis, const Tracker &t, const LawBatch &batch, const LawScratch &scratch);

    Plant *plant_ = nullptr;
    AxisGroup *group_ = nullptr;
    Positioner *positioners_ = nullptr;
    const uint16_t *members_ = nullptr; // those in the lanes of the group: the plant may rearrange them
    const PositionerGroup *notes_ = nullptr;
    bool side_by_side_ = true;
    uint32_t awake_ = 0, runs_ = 0; // positioners that are awake; and whose ticks their firmware does
    // positioners in the lanes, a bit each: all, by axis, and those of an axis that heed what blocks or
    // settle
    uint32_t cruise_ = 0;
    std::array<uint32_t, FL_AXES> cruise_axis_{}, heeds_{}, settles_{};
    std::array<uint64_t, lane_group_size> since_{};
    std::array<uint32_t, lane_group_size> ticks_{}; // from then on, to the one at which it leaves
    std::array<uint32_t, FL_AXES> laws_{};          // of those in the lanes: a bit of 1 << law for each
    uint64_t next_leave_ = UINT64_MAX;
    // axes whose configuration lies in the batch, by lane: until a release
    std::array<std::array<bool, lane_group_size>, FL_AXES> loaded_{};
    std::array<LawBatch, FL_AXES> batches_{};
    std::array<std::unique_ptr<ContactLanes>, FL_AXES> contacts_; // where a lane has wanted that law
};

} // namespace fl::twin
