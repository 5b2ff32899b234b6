// From a path on the grid to the points that are sent.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/descent.hpp"

namespace fl::planning {

// The last cut corner of a path ends half a step after its last step, in this quarter.
constexpr int end_of_path(int steps) { return quarters * steps + quarters / 2; }

// The motion along a path, as it is sent.
Motion motion_of(const Robot &robot, const List<Cell> &path, const Clock &clock);

// The descent after a motion, from above the goal down to it, beginning in a quarter.
// @pre the motion has ended by then.
void add_descent(Motion &motion, const Descent &descent, const Clock &clock, int begin);

// When a turn of the descents begins if the first one begins in a quarter.
double turn_begins_s(const Clock &clock, int begin, int turn);

} // namespace fl::planning
