// Fewer points for axes that would have more than the bus shall carry: some are left out where the straight
// motion between those that stay keeps clear of all bodies.
#pragma once

#include "search/path_set.hpp"

namespace fl::planning {

// Where an axis changes its speed: its angle so many quarters of a step after the start.
struct Knot {
    int quarter = 0;
    double angle_rad = 0.0;
};
using Knots = List<Knot>;

// Of both axes of a positioner; empty where it has those of its path.
struct OwnKnots {
    Knots alpha, beta;
};

// Takes points from every axis that has more than these, as far as that keeps all apart. The paths then sweep
// what is sent; no other path may be sought afterwards.
// @pre no two paths conflict.
List<OwnKnots, PathIndex> fewer_points(PathSet &paths, int most_points, const Enough &enough);

// Makes the motion of a path, as it is sent, one along these knots.
void follow(const OwnKnots &own, double quarter_s, Motion &motion);

} // namespace fl::planning
