// Which centres are near each other, without looking at all pairs: they are put into square bins, and each
// bin is compared with those around it.
#pragma once

#include "motion/index.hpp"
#include "motion/swept_arm.hpp"

namespace fl::planning {

struct NearPair {
    int first, second; // places in the list of centres, the lower one first
    double gap_mm;
};

// All pairs of centres less than widest_mm apart. Takes time in proportion to their number where they are
// spread as positioners are.
// @pre centres are finite, widest_mm is above 0.
List<NearPair> near_pairs(const List<Vec2> &centres, double widest_mm);

} // namespace fl::planning
