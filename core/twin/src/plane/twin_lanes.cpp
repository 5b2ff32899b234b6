// Who is stepped together with whom. A group of lanes takes its time until the last of them rests: those
// with paths of about the same length share one.
#include <algorithm>
#include <cstddef>
#include <iterator>
#include <utility>

#include "twin_state.hpp"

namespace fl::twin {
namespace {

// Of the longer of its two paths, from START to end. Those that are on their way already, or on a go-to, rest
// at another time: that costs time alone.
uint32_t ticks_of_way(const fl_positioner_t &firmware) {
    int32_t ticks = 0;
    for (size_t axis = 0; axis < FL_AXES; ++axis)
        if (!fl_axis_rests(&firmware.axis[axis])) ticks = std::max(ticks, firmware.path[axis].last_tick + 1);
    return static_cast<uint32_t>(ticks);
}

} // namespace

// Those that rest first, then those with the shortest paths: of the groups of each thread, so that what lies
// side by side in memory is written by the same one. Those of a vector in their order.
std::vector<uint16_t> Twin::State::by_end_of_way() const {
    std::vector<uint32_t> ticks;
    for (size_t i = 0; i < count; ++i) ticks.push_back(ticks_of_way(positioners[i].firmware()));
    std::vector<uint16_t> order = plant.members();
    const auto from = [&](size_t slot) {
        return order.begin() + static_cast<std::ptrdiff_t>(std::min(slot, count));
    };
    const size_t threads = workers.thread_count();
    for (size_t thread = 0; thread < threads; ++thread) {
        const size_t first = Workers::first_of(thread, threads, groups.size()) * lane_group_size;
        const size_t last = Workers::first_of(thread + 1, threads, groups.size()) * lane_group_size;
        std::stable_sort(from(first), from(last), [&](size_t i, size_t j) { return ticks[i] < ticks[j]; });
    }
    constexpr size_t together = std::min(chunk_size, lane_group_size);
    for (size_t slot = 0; slot < count; slot += together) std::sort(from(slot), from(slot + together));
    return order;
}

void Twin::State::prepare() {
    if (std::exchange(started, false) && sort_lanes) rearrange();
}

// Between two ticks. Masks of a group have a bit for each of its lanes.
void Twin::State::rearrange() {
    const std::vector<uint16_t> order = by_end_of_way(), before = plant.members();
    if (order == before) return;
    for (size_t i = 0; i < count; ++i) release(i);

    using Mask = uint32_t PositionerGroup::*;
    constexpr Mask masks[] = {&PositionerGroup::awake, &PositionerGroup::posed, &PositionerGroup::disturbed};
    std::vector<uint32_t> noted(count); // by positioner: a bit for each of the masks
    for (size_t slot = 0; slot < count; ++slot)
        for (size_t k = 0; k < std::size(masks); ++k)
            noted[before[slot]] |= (groups[slot / lane_group_size].*masks[k] >> slot % lane_group_size & 1U)
                                   << k;
    gather_outboxes();
    plant.rearrange(order);

    for (PositionerGroup &group : groups) {
        for (const Mask mask : masks) group.*mask = 0;
        group.moved = true; // one that was may be among them
    }
    std::fill(scoped.begin(), scoped.end(), 0);
    for (size_t slot = 0; slot < count; ++slot) {
        PositionerGroup &group = groups[slot / lane_group_size];
        const size_t i = order[slot], lane = slot % lane_group_size;
        positioners[i].move(group, lane);
        for (size_t k = 0; k < std::size(masks); ++k) group.*masks[k] |= (noted[i] >> k & 1U) << lane;
        scoped[slot / lane_group_size] |= static_cast<uint32_t>(positioners[i].scoped()) << lane;
    }
}

// What positioners have sent comes before what they send in their new groups.
void Twin::State::gather_outboxes() {
    Outbox all;
    for (PositionerGroup &group : groups) {
        Outbox box = std::move(group.outbox);
        all.frames.insert(all.frames.end(), box.frames.begin(), box.frames.end());
        all.touches.insert(all.touches.end(), box.touches.begin(), box.touches.end());
        group.outbox = {};
    }
    if (!groups.empty()) groups.front().outbox = std::move(all);
}

} // namespace fl::twin
