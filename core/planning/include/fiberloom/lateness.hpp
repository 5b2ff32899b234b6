// Whether a plan stays free of collisions if one positioner is late, by other code than the planner's.
//
// One positioner lags behind its schedule, all others are on time: it is where the plan has it at t when they
// are where the plan has them at s, 0 <= s - t <= the lateness. So of each two that move all such moments are
// looked at: a band of the plane (t, s) beside its diagonal. In a cell of it no point of an arm gets farther
// from its place in the middle than its way. So the gap in the cell is never below that in the middle less
// both ways. Cells are halved until this shows that the arms stay apart, or that they touch.
#pragma once

#include "fiberloom/planning.hpp"

#include <vector>

namespace fl::planning {

// One positioner (row) that would touch another one if it were late.
struct LatePair {
    int late = -1;
    int other = -1;
    double bears_s = 0.0; // no lateness below this makes them touch; one that is 0.001 s longer does
    // Of the deepest moment of all that are no later than was asked for; of the first touch where that is
    // later: the moment of the plan at which each of them is, and how deep the buffers overlap.
    double late_at_s = 0.0;
    double other_at_s = 0.0;
    double depth_mm = 0.0; // to 0.01 mm
};

struct Lateness {
    std::vector<LatePair> pairs; // those that touch at some lateness, by rows
    int looked_at = 0;           // pairs of positioners that both move and can meet, each order for itself
};

// For each two positioners that both move, which lateness of the one the other bears. late_s: the moments
// that are looked at for depth; infinite: the late one may stop for good. Plans in which arms are in contact
// when all are on time bear nothing in these pairs. One that rests has been looked at by `verify`.
// @pre one sound motion for each of bodies.arms; late_s is not negative.
Lateness lateness(const Bodies &bodies, const std::vector<Motion> &motions, double late_s);

} // namespace fl::planning
