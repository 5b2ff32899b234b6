// Collision-free motion of all positioners from where they are to where they must be.
//
// Bodies: docs/planning.md. A positioner is one or more capsules that are fixed to its arms; fiducials
// (discs), guide cameras (capsules), keep-outs and positioners that are offline do not move. Lengths in mm,
// angles in rad, times in s.
#pragma once

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace fl::planning {

// The heights that a body takes up, a bit each: bodies without a common one cannot touch.
using Layers = std::uint32_t;
inline constexpr Layers first_layer = 1, all_layers = ~Layers{0};

// All points within a radius of a line. owner: the positioner (row) whose uncertain place it covers, which
// cannot touch it; -1: none.
struct Capsule {
    Segment line;
    double radius_mm = 0.0;
    Layers layers = all_layers;
    int owner = -1;
};

// The same, fixed to an arm: x runs along the beta arm from the beta axis, or along the alpha arm from the
// alpha axis; y to the left. The radius includes the collision buffer.
struct Part {
    Segment line;
    double radius_mm = 0.0;
    bool on_alpha = false;
    Layers layers = first_layer;
};

// Everything that takes room. parts: of each arm. Those on two alpha arms cannot touch: their discs do not.
// @pre one row of parts for each arm, none of them empty.
struct Bodies {
    std::vector<Arm> arms;
    std::vector<std::vector<Part>> parts;
    std::vector<Capsule> obstacles;
};

// The motion of one positioner: straight between points in both angles. One point: it does not move.
struct Motion {
    std::vector<double> time_s;
    std::vector<Angles> angles;
};

// Called while a plan is made: the name of a stage, and how many of its parts are done. It must not throw.
using Watch = std::function<void(const char *stage, int done, int total)>;

// Called while a plan is made: whether it shall come to an end. It must not throw.
using Enough = std::function<bool()>;

// Speeds of the axes, the search grid, and how hard the planner tries.
struct Settings {
    double speed_rad_s = 0.0;
    double acceleration_rad_s2 = 0.0;
    double grid_rad = 0.0;       // widest step of the search grid
    double tick_s = 0.0005;      // times are multiples of this
    double clearance_mm = 0.001; // kept beyond touching, for rounding on the bus
    double in_hand_mm = 0.05;    // kept beyond that by an arm on its way, where it can be
    // Any one positioner may be late by so much, the others being on time; infinite: it may stop for good. So
    // as far as it can be had: no goal is given up for it.
    double late_s = 0.0;
    double first_deadline = 1.05; // of the time the longest path needs
    double last_deadline = 2.0;   // beyond this a positioner is given up
    double effort = 1.0;          // scales how long the repair goes on before one is given up
    int approach_turns = 4;       // in so many turns positioners may come down to their goals, if they must
    int most_points = 40;         // of an axis: beyond that points are left out, as far as all stay clear
    std::uint64_t seed = 0;
    Watch watch = [](const char *, int, int) {};
    Enough enough = [] { return false; };
};

// From which side of a goal the last leg of each axis comes: 1 from above, -1 from below.
struct Sides {
    double alpha = 1.0, beta = 1.0;
    // The place so far beside a goal, rad.
    Angles beside(double height_rad) const { return {alpha * height_rad, beta * height_rad}; }
};

// What a plan must do; one row for each of Bodies::arms. travel: the room that the axes have.
struct Task {
    std::vector<Angles> start;
    std::vector<Angles> goal;
    std::vector<double> approach_rad; // how far from the goal the last leg starts, on both axes: see sides
    std::vector<std::uint8_t> fixed;  // not 0: cannot move
    Limits travel{};
    // An approach that would touch may be shortened to this; empty: no approach may.
    std::vector<double> least_approach_rad{};
    // Of single positioners, cold or worn; empty: as in the settings.
    std::vector<double> speed_rad_s{};
    std::vector<double> acceleration_rad_s2{};
    Sides sides{};
    // Of single positioners, where they have their own; empty: as travel.
    std::vector<Limits> travels{};
};

// The room of a row: of a task or of rules.
template <class Of> const Limits &travel_of(const Of &of, int robot) {
    return of.travels.empty() ? of.travel : of.travels[static_cast<std::size_t>(robot)];
}

// What the axes of a positioner can do.
struct Pace {
    double speed_rad_s = 0.0;
    double acceleration_rad_s2 = 0.0;
};

// That of a row of the task.
Pace pace_of(const Settings &settings, const Task &task, int robot);

// The common clock of a plan. A step lasts four quarters; all times are multiples of a quarter, and
// a quarter is a multiple of the tick of the bus.
struct Clock {
    double quarter_s = 0.0;
    int turn_quarters = 0;   // how long an approach lasts
    double widest_rad = 0.0; // of a move in a step

    // The shortest steps in which the fastest of those that may move go about settings.grid_rad, and the
    // slowest no less than a quarter of it.
    // @pre speeds, accelerations, grid and tick are above 0.
    Clock(const Settings &settings, const Task &task);
    // Duration of a step, s.
    double step_s() const { return 4 * quarter_s; }
    // The widest move in a step.
    double grid_rad(Pace pace) const;
    // The highest approach that may begin in the turn after one in which the axis has gone up to it.
    double highest_hook_rad(double acceleration_rad_s2) const;
};

// The last leg of one axis: to the goal from a height above it, or from below where that is negative, between
// two moments.
struct LastLeg {
    double height_rad = 0.0;
    double begin_s = 0.0;
    double end_s = 0.0;
};

// How a positioner (row) comes to its goal from above, if not as all others do.
struct Approach {
    int robot = -1;
    LastLeg alpha, beta;
};

// Why a positioner does not arrive.
enum class Refusal {
    goal_beyond_travel,
    approach_beyond_travel,
    goal_blocked,
    approach_blocked,
    goal_taken,
    approach_at_goal,
    goal_on_approach,
    approach_taken,
    no_way_alone,
    no_way,
    locked,
    start_blocked
};

// The reason as the end of a sentence that begins with the positioner's name. {other} and {still}: what it
// meets, the latter something that does not move; {axes}: what its axes would need beyond their travel.
const char *to_string(Refusal reason);

// A positioner (row) that does not arrive, and what it meets: another positioner or an obstacle; -1: neither.
struct Refused {
    int robot = -1;
    Refusal reason = Refusal::no_way;
    int other = -1;
    int obstacle = -1;
};

// What a plan took.
struct Statistics {
    std::int64_t searches = 0;
    std::int64_t expansions = 0; // of nodes, over all searches
    std::int64_t repairs = 0;
    int first_conflicts = 0;  // pairs, before any repair
    int bound_steps = 0;      // that the longest path needs if nothing is in its way
    double steps = 0.0;       // until the approach of the last ones begins, by quarters
    int quarters_earlier = 0; // of a step, than the paths end
    double step_s = 0.0;
    bool cut_short = false;                     // by Settings::enough
    bool late = false;                          // planned with Settings::late_s in all pairs but ...
    std::vector<std::array<int, 2>> not_late{}; // ... these (rows, the lower first)
};

// One motion for each row of the task, the rows that do not arrive, what the plan took, and the rows that
// come to their goals in a way of their own.
struct PlanResult {
    std::vector<Motion> motions;
    std::vector<Refused> refused;
    Statistics statistics;
    std::vector<Approach> approaches{};
};

// Plans for all positioners at once. One that cannot arrive is named in `refused` and gets a place where it
// blocks no other; in the worst case none moves. The same arguments give the same bits, unless it is cut
// short: then those that still meet others are given up, and nothing is hurried or straightened any more. The
// caller verifies what comes back (verify.hpp).
// @pre start, goal, approach_rad and fixed have as many rows as bodies.arms, the others as many or none;
// approach_rad is not negative, and not below least_approach_rad; as for Clock.
PlanResult plan(const Bodies &bodies, const Task &task, const Settings &settings);

} // namespace fl::planning
