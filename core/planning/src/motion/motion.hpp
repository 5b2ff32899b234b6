// From a path on the grid to the points that are sent.
#pragma once

#include "fiberloom/planning.hpp"
#include "motion/robot.hpp"

namespace fl::planning {

// The motion along a path of `steps` steps, and the approach after it: from the last cell down by
// approach_rad on both axes.
Motion motion_of(const Robot &robot, const List<Cell> &path, int steps, const Clock &clock,
                 double approach_rad);

// The approach as a step: from approach_rad above the goal, on both axes, to the goal.
SweptArm approach_leg(const ArmBody &body, Angles goal, double approach_rad);

} // namespace fl::planning
