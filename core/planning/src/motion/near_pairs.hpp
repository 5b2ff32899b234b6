// Which positioners can meet, without looking at all pairs: their centres are put into square bins, and each
// bin is compared with those around it.
#pragma once

#include "motion/index.hpp"
#include "motion/swept_arm.hpp"

namespace fl::planning {

struct NearPair {
    int first, second; // places in the list of bodies, the lower one first
    double gap_mm;     // between their centres
};

// A body that turns around a centre.
struct Reach {
    Vec2 centre_mm;
    double far_mm; // the farthest of its points
};

// All pairs that can come nearer to each other than need_mm. Takes time in proportion to their number where
// they are spread as positioners are.
// @pre centres are finite, far_mm is above 0.
List<NearPair> near_pairs(const List<Reach> &bodies, double need_mm);

} // namespace fl::planning
