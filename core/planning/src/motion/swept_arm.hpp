// What a beta arm sweeps in one time step, and the test whether two of them stay apart during all of it.
//
// A step is cut into four quarters; within a quarter both angles run straight in time. The ends of the arm's
// centre line are kept at the five borders. Between borders an end follows an arc, which leaves its
// chord by at most `bulge_mm`; the test treats ends as moving on chords and adds the bulges.
#pragma once

#include "fiberloom/planning.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {

inline constexpr int quarters = 4;

struct Shape;

struct SweptArm {
    Segment at[quarters + 1] = {};      // the centre line at the borders of the quarters
    double displacement_bound_mm = 0.0; // no point of the arm gets farther from its place at mid-step
    double bulge_mm = 0.0;              // arc against chord, within a quarter
    double extra_mm = 0.0;              // its radius above the least one, which is part of what is needed
    const Shape *shape = nullptr;       // of a body of several limbs: all within that radius
    Layers layers = first_layer;        // of one without a shape
};

inline Vec2 operator-(Vec2 p, Vec2 q) { return {p.x - q.x, p.y - q.y}; }
inline double dot(Vec2 p, Vec2 q) { return p.x * q.x + p.y * q.y; }
inline double cross(Vec2 p, Vec2 q) { return p.x * q.y - p.y * q.x; }
inline double length(Vec2 p) { return std::sqrt(dot(p, p)); }
inline Vec2 middle(Vec2 p, Vec2 q) { return {0.5 * (p.x + q.x), 0.5 * (p.y + q.y)}; }
inline Segment middle(const Segment &p, const Segment &q) { return {middle(p.a, q.a), middle(p.b, q.b)}; }

// Without a jump: which of the three it is is hard to foretell.
inline double clamp01(double t) {
    const double above = t > 0.0 ? t : 0.0;
    return above < 1.0 ? above : 1.0;
}

// Squared distance of the point r (seen from the segment's first end) from a segment d.
inline double squared_to(Vec2 r, Vec2 d, double inverse) {
    const double t = clamp01(dot(r, d) * inverse);
    const double x = r.x - t * d.x, y = r.y - t * d.y;
    return x * x + y * y;
}

// Two numbers at once: every processor of 64 bits has such.
using Double2 = double __attribute__((vector_size(16)));
inline Double2 lower(Double2 p, Double2 q) { return p < q ? p : q; }

// The same of two points.
inline Double2 squared_to(Double2 x, Double2 y, Vec2 d, double inverse) {
    const Double2 along = (x * d.x + y * d.y) * inverse, none{0.0, 0.0}, all{1.0, 1.0};
    const Double2 t = lower(along > none ? along : none, all);
    const Double2 off_x = x - t * d.x, off_y = y - t * d.y;
    return off_x * off_x + off_y * off_y;
}

// Squared distance of two segments, 0 where they cross.
inline double squared_distance(const Segment &p, const Segment &q) {
    const Vec2 dp = p.b - p.a, dq = q.b - q.a, r = p.a - q.a;
    const Double2 x{r.x, r.x + dp.x}, y{r.y, r.y + dp.y}; // the ends of p from q.a
    const Double2 sides = dq.x * y - dq.y * x;
    if ((sides[0] < 0.0) != (sides[1] < 0.0)) {
        // the ends of p lie on both sides of q's line; now those of q
        const double other0 = cross(r, dp), other1 = cross({r.x - dq.x, r.y - dq.y}, dp);
        if ((other0 < 0.0) != (other1 < 0.0)) return 0.0;
    }
    const double lp = dot(dp, dp), lq = dot(dq, dq);
    const double ip = lp > 0.0 ? 1.0 / lp : 0.0, iq = lq > 0.0 ? 1.0 / lq : 0.0;
    const Double2 x_from_p{-r.x, dq.x - r.x}, y_from_p{-r.y, dq.y - r.y}; // the ends of q from p.a
    const Double2 least = lower(squared_to(x, y, dq, iq), squared_to(x_from_p, y_from_p, dp, ip));
    return std::min(least[0], least[1]);
}

// The same of a point: of a segment both of whose ends are there.
inline double squared_distance(Vec2 p, const Segment &q) {
    const Vec2 d = q.b - q.a, r = p - q.a, s = d - r;
    const double squared = dot(d, d), inverse = squared > 0.0 ? 1.0 / squared : 0.0;
    return std::min(squared_to(r, d, inverse), std::min(dot(r, r), dot(s, s)));
}

inline double distance(const Segment &p, const Segment &q) { return std::sqrt(squared_distance(p, q)); }

// Two centre lines at one moment, and their distance.
struct TwoLines {
    Segment p, q;
    double distance_mm = 0.0;
};

// How far apart the ends of two segments move between two moments, at most: by so much, and no more, can
// the distance of any two of their points change.
double relative_displacement(const TwoLines &from, const TwoLines &to);

// True only if the centre lines stay at least `need_mm` and both extra radii apart during the whole step; of
// bodies with shapes, those of all limbs that share a layer.
bool stay_apart(const SweptArm &p, const SweptArm &q, double need_mm);
// With the distance of the centre lines in mid-step, where it is known.
bool stay_apart(const SweptArm &p, const SweptArm &q, double middle_mm, double need_mm);

// One quarter of a step, as a step. Where the arm rests in it, it bulges by nothing.
SweptArm quarter_of(const SweptArm &swept, int quarter);

// The same as stay_apart whatever the moments within the step at which the one and the other are.
bool ever_apart(const SweptArm &p, const SweptArm &q, double need_mm);
bool ever_apart(const SweptArm &p, const SweptArm &q, double middle_mm, double need_mm);

// The same two for lines with their places at the borders of the quarters, and all that they need.
using ChordsTest = bool (*)(const Segment *p, const Segment *q, double need_mm);
bool chords_stay_apart(const Segment *p, const Segment *q, double need_mm);
bool chords_ever_apart(const Segment *p, const Segment *q, double need_mm);

// A body that does not move, as a step.
SweptArm resting_arm(const Segment &line, double extra_mm = 0.0, const Shape *shape = nullptr);

// Fills in displacement_bound_mm from the centre lines at the borders and the bulge.
void measure_displacement_bound(SweptArm &swept);

} // namespace fl::planning
