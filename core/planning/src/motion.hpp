// From a way on the grid to the points that are sent.
#pragma once

#include "fiberloom/planning.hpp"
#include "robot.hpp"

#include <vector>

namespace fl::planning {

// The motion along a way of `steps` steps, and the approach after it: from the last cell down by
// approach_rad on both axes.
Motion motion_of(const Robot &robot, const std::vector<Cell> &way, int steps, const Clock &clock,
                 double approach_rad);

// The approach as a step: from `approach` above the goal to the goal.
Piece approach_leg(const Arm &arm, double from_mm, double to_mm, Angles goal, double approach_rad);

} // namespace fl::planning
