// Positioners that come down to their goals soon after they are above them, and not with the last ones: from
// then on their motors rest.
#pragma once

#include "motion/descent.hpp"
#include "points/own_knots.hpp"
#include "search/path_set.hpp"

namespace fl::planning {

// From above the goal down to it.
struct WayDown {
    const Descent &descent;
    const Legs &legs;
};

// In quarters: when those that come down last begin, and how long each turn takes.
struct EndOfPlan {
    int begin = 0, turn = 0;
};

// For each path the quarter in which its descent begins: as early as the axes have been at rest for a step,
// where the arm then keeps clear of all until the plan ends, and of all descents; otherwise the end. The
// paths then sweep what is sent; no other path may be sought afterwards.
// own: of those that do not go as their paths do.
// @pre no two paths conflict, and no two ways down.
List<int, PathIndex> early_descents(PathSet &paths, const List<OwnKnots, PathIndex> &own,
                                    const List<WayDown, PathIndex> &ways, EndOfPlan end, double need_mm);

} // namespace fl::planning
