#include "fiberloom/twin/axis_group.hpp"

#include <cstring>

namespace fl::twin {
namespace {

// Rows of one number for each lane, from byte `begin` of the group to byte `end`.
template <size_t width>
void copy_rows(const AxisGroup &from, size_t from_lane, AxisGroup &to, size_t to_lane, size_t begin,
               size_t end) {
    const auto *source = reinterpret_cast<const unsigned char *>(&from);
    auto *target = reinterpret_cast<unsigned char *>(&to);
    for (size_t row = begin; row < end; row += width * lane_count)
        std::memcpy(target + row + width * to_lane, source + row + width * from_lane, width);
}

void copy_bit(uint64_t from, size_t from_lane, uint64_t &to, size_t to_lane) {
    to = (to & ~(uint64_t{1} << to_lane)) | (from >> from_lane & 1) << to_lane;
}

} // namespace

void copy_lane(const AxisGroup &from, size_t from_lane, AxisGroup &to, size_t to_lane) {
    constexpr size_t in_double = offsetof(AxisGroup, p_Nms), masks = offsetof(AxisGroup, near_stop);
    static_assert(in_double % sizeof(AxisGroup::Exact) == 0);
    static_assert((masks - in_double) % sizeof(AxisGroup::Lanes) == 0);
    static_assert(offsetof(AxisGroup, block_ends) == masks + 2 * sizeof(uint64_t));
    copy_rows<sizeof(double)>(from, from_lane, to, to_lane, 0, in_double);
    copy_rows<sizeof(float)>(from, from_lane, to, to_lane, in_double, masks);
    copy_bit(from.near_stop, from_lane, to.near_stop, to_lane);
    copy_bit(from.leaving, from_lane, to.leaving, to_lane);
    copy_bit(from.block_ends, from_lane, to.block_ends, to_lane);
}

} // namespace fl::twin
