// Proof that a plan is safe, by other code and another method than the planner's.
//
// Between two moments no point of an arm moves farther than its way: the integral of
// l_a |d alpha| + far |d alpha + d beta|. So the gap of two bodies with gaps g0 and g1 at the ends of an
// interval and ways w_i, w_j in it is never below (g0 + g1 - w_i - w_j) / 2. Intervals are halved until
// this bound shows that the bodies stay apart, or a moment is found at which they do not. Bodies that
// overlap at the start and shall separate: in such an interval the gap falls by no more than
// (g0 - g1 + w_i + w_j) / 2, and intervals are halved until that is too little to matter.
#pragma once

#include "fiberloom/planning.hpp"

#include <vector>

namespace fl::planning {

// What may be wrong with a plan.
enum class Fault {
    robots,           // two positioners, at least one of which moves, come too close
    obstacle,         // a positioner that moves comes too close to a fiducial or guide camera
    contact,          // two positioners that do not move in this plan are too close
    obstacle_contact, // one that does not move is too close to a fiducial or guide camera
    points,           // times do not rise from 0, or something is not a finite number
    travel,           // beyond the travel of an axis
    speed,            // faster than allowed
    acceleration,     // speed changes faster than allowed
    start,            // does not begin where the positioner is
    goal,             // does not end where it shall
    approach,         // does not end with the approach, or not in the way that was said
    closing,          // two positioners that overlap at the start come nearer to each other
    obstacle_closing, // one that overlaps a fiducial or guide camera at the start comes nearer to it
};

// The name of the enumerator.
const char *to_string(Fault fault);

// One fault of one positioner (row) at one time. depth: mm below the clearance, or rad, rad/s, rad/s^2 beyond
// the limit. other: the positioner, or the index of the obstacle; -1 if there is none.
struct Violation {
    Fault fault;
    int robot = -1;
    int other = -1;
    double time_s = 0.0;
    double depth = 0.0;
};

// What motions are held to.
struct Rules {
    double speed_rad_s = 0.0;
    double acceleration_rad_s2 = 0.0;
    // Of single positioners; empty: the same for all.
    std::vector<double> own_speed_rad_s{};
    std::vector<double> own_acceleration_rad_s2{};
    Limits travel{};
    double rounding_rad = 0.0; // how far angles may be off by rounding
    // Bodies that overlap at the start may move if their gap only grows, to within 1 um, until it is no
    // longer negative; it may not become negative again. Without this flag they may not move.
    bool separating = false;
    // One row for each positioner; empty: not checked. goal: only where the flag in `arrives` is set.
    std::vector<Angles> start;
    std::vector<Angles> goal;
    std::vector<std::uint8_t> arrives;
    std::vector<double> approach_rad;
    // Of those that say in which way they come to their goals, at most one each: last legs as they say, and
    // from no less than approach_rad.
    std::vector<Approach> approaches{};
    Sides sides{};
    // Of single positioners, where they have their own; empty: as travel.
    std::vector<Limits> travels{};
};

// The smallest gap between surfaces found, true to 1e-4 mm, and where: a positioner (row), and the other or
// the obstacle. -1 where nothing came near.
struct Gap {
    double gap_mm = 1e9;
    double time_s = 0.0;
    int robot = -1;
    int other = -1;
};

// What is wrong, and how near to wrong the rest is.
struct Verification {
    std::vector<Violation> violations;
    Gap robots;
    Gap obstacles;
    double top_speed_rad_s = 0.0;
    double top_acceleration_rad_s2 = 0.0;
    double top_jump_rad_s = 0.0; // largest change of speed at a point
};

// Whether points of a motion are finite numbers and their times rise from 0: without that no proof means
// anything.
bool sound(const Motion &motion);

// Checks points, speeds, accelerations, travel and ends of every motion, and the gaps of all bodies in
// continuous time. Motions whose points are not sound (Fault::points) end the check: nothing else has a
// meaning then.
// @pre one motion for each of bodies.arms, and as many rows in the rules that are not empty; approaches of
// some of them.
Verification verify(const Bodies &bodies, const std::vector<Motion> &motions, const Rules &rules);

} // namespace fl::planning
