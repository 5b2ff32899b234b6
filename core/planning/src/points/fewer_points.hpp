// Fewer points for axes that would have more than the bus shall carry: some are left out where the straight
// motion between those that stay keeps clear of all bodies.
#pragma once

#include "points/own_knots.hpp"
#include "search/path_set.hpp"

namespace fl::planning {

// Takes points from every axis that has more than these, as far as that keeps all apart. The paths then sweep
// what is sent; no other path may be sought afterwards.
// own: of those that do not go as their paths do, also of those from which points are taken.
// @pre no two paths conflict.
void fewer_points(PathSet &paths, int most_points, const Enough &enough, List<OwnKnots, PathIndex> &own);

} // namespace fl::planning
