// Distances between the outlines of arms in the focal plane. A body is a capsule: all points within
// a radius of a segment (a disc is a capsule whose ends coincide). Lengths in mm.
#pragma once

#include "fiberloom/arm.hpp"

namespace fl {

// A straight line from a to b, mm; a point where they coincide.
struct Segment {
    Vec2 a;
    Vec2 b;
};

// Where two segments come closest: a point on each, how far along each it lies (0 at the first end,
// 1 at the second), and the distance. Segments that cross have distance 0 and both points at the crossing.
struct Closest {
    Vec2 on_first;
    Vec2 on_second;
    double along_first = 0.0;
    double along_second = 0.0;
    double distance_mm = 0.0;
};

// The point of a segment nearest to p. on_first is p itself.
Closest closest_point(Vec2 p, const Segment &segment);

// The nearest points of two segments, degenerate ones included; of several pairs one is returned.
Closest closest_points(const Segment &first, const Segment &second);

// The distance of p from a segment, mm.
double point_segment_distance(Vec2 p, const Segment &segment);

// The same number as closest_points().distance_mm, without the points: what planner and twin call
// most. Exact up to rounding for every input, degenerate segments included.
double segment_distance(const Segment &first, const Segment &second);

// The centre line of a beta arm's capsule: from x = from_mm to x = to_mm of the beta arm's frame.
Segment beta_segment(const Arm &arm, double from_mm, double to_mm, Angles angles);

} // namespace fl
