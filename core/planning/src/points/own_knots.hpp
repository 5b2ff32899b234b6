// The motion of a positioner by the points at which its axes change their speed.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/index.hpp"

namespace fl::planning {

// Where an axis changes its speed: its angle so many quarters of a step after the start.
struct Knot {
    int quarter = 0;
    double angle_rad = 0.0;
};
using Knots = List<Knot>;

// Straight between knots; at rest before the first and after the last one.
double angle_at(const Knots &knots, int quarter);

// Of both axes of a positioner; empty where it has those of its path.
struct OwnKnots {
    Knots alpha, beta;
    bool empty() const { return alpha.empty(); }
};

// The motion along these knots, without the descent after it.
Motion motion_along(const OwnKnots &own, double quarter_s);

} // namespace fl::planning
