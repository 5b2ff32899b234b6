// From a way on the grid to the points that are sent.
#pragma once

#include "fiberloom/planning.hpp"
#include "robot.hpp"

#include <vector>

namespace fl::planning {

// The common clock of a plan. A step lasts four quarters; all times are multiples of a quarter, and
// a quarter of the tick of the bus.
struct Clock {
    double quarter_s = 0.0;
    double grid_rad = 0.0; // widest move in a step
    int leg_quarters = 0;  // how long each third of the approach lasts

    // The shortest steps of about settings.grid_rad that speed and acceleration allow.
    explicit Clock(const Settings &settings);
    double step_s() const { return quarters * quarter_s; }
};

// The motion along a way of `steps` steps, and the approach after it: from the last cell down by
// approach_rad on both axes.
Motion motion_of(const Robot &robot, const std::vector<Cell> &way, int steps, const Clock &clock,
                 double approach_rad);

// The approach as a step: from `approach` above the goal to the goal.
Piece approach_leg(const Arm &arm, double from_mm, double to_mm, Angles goal, double approach_rad);

} // namespace fl::planning
