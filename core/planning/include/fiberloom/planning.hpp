// Collision-free motion of all positioners from where they are to where they must be.
//
// Bodies: docs/planning.md. A positioner is the capsule of its beta arm; fiducials (discs), guide
// cameras (capsules) and positioners that are offline do not move. Lengths in mm, angles in rad, times in s.
#pragma once

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"

#include <cstdint>
#include <string>
#include <vector>

namespace fl::planning {

struct Capsule {
    Segment line;
    double radius_mm = 0.0;
};

// Everything that takes room. The centre line of a beta arm runs from x = from_mm to x = to_mm of
// its frame; radius_mm is the collision buffer, the same for all.
struct Bodies {
    std::vector<Arm> arms;
    double from_mm = 0.0;
    double to_mm = 0.0;
    double radius_mm = 0.0;
    std::vector<Capsule> obstacles;
};

// The motion of one positioner: straight between points in both angles. One point: it stands still.
struct Motion {
    std::vector<double> time_s;
    std::vector<Angles> angles;
};

struct Settings {
    double speed_rad_s = 0.0;
    double acceleration_rad_s2 = 0.0;
    double grid_rad = 0.0;        // widest step of the search grid
    double tick_s = 0.0005;       // times are multiples of this
    double clearance_mm = 0.001;  // kept beyond touching, for rounding on the bus
    double first_deadline = 1.05; // of the time the longest way needs
    double last_deadline = 2.0;   // beyond this a positioner is given up
    double effort = 1.0;          // scales how long the repair goes on before somebody is given up
    std::uint64_t seed = 0;
};

// Where each positioner is and shall be, how far above the goal its last leg starts on both axes, who does
// not move at all, and the room the axes have.
struct Task {
    std::vector<Angles> start;
    std::vector<Angles> goal;
    std::vector<double> approach_rad;
    std::vector<std::uint8_t> fixed;
    Limits travel{};
};

// The common clock of a plan. A step lasts four quarters; all times are multiples of a quarter, and
// a quarter of the tick of the bus.
struct Clock {
    double quarter_s = 0.0;
    double grid_rad = 0.0; // widest move in a step
    int leg_quarters = 0;  // how long each third of the approach lasts

    // The shortest steps of about settings.grid_rad that speed and acceleration allow.
    Clock(const Settings &settings, double highest_approach_rad);
    Clock(const Settings &settings, const Task &task);
    double step_s() const { return 4 * quarter_s; }
};

// Why a positioner does not arrive. `other` is the positioner in its way, -1 if none.
enum class Refusal { goal_beyond_travel, goal_blocked, goal_taken, no_way_alone, no_way, start_blocked };
const char *to_string(Refusal reason);

struct Refused {
    int robot = -1;
    Refusal reason = Refusal::no_way;
    int other = -1;
};

struct Statistics {
    std::int64_t searches = 0;
    std::int64_t expansions = 0;
    std::int64_t repairs = 0;
    int straight_conflicts = 0;
    int first_conflicts = 0;
    int bound_steps = 0;
    int steps = 0;
    double step_s = 0.0;
};

struct PlanResult {
    std::vector<Motion> motions;
    std::vector<Refused> refused;
    Statistics statistics;
};

// Plans for all positioners at once. Whoever cannot arrive is named in `refused` and gets a place where
// he is in nobody's way. The caller verifies what comes back (verify.hpp).
PlanResult plan(const Bodies &bodies, const Task &task, const Settings &settings);

} // namespace fl::planning
