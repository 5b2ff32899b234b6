// From a path on the grid to the points that are sent.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/descent.hpp"

namespace fl::planning {

// The motion along a path of `steps` steps, and the descent after it, from the last cell.
Motion motion_of(const Robot &robot, const List<Cell> &path, int steps, const Clock &clock,
                 const Descent &descent);

// When a turn of the descents begins after a path of so many steps.
double turn_begins_s(const Clock &clock, int steps, int turn);

} // namespace fl::planning
