#include "fiberloom/distance.hpp"

#include <algorithm>
#include <cmath>

namespace fl {
namespace {

Vec2 operator-(Vec2 p, Vec2 q) { return {p.x - q.x, p.y - q.y}; }
double dot(Vec2 p, Vec2 q) { return p.x * q.x + p.y * q.y; }
double cross(Vec2 p, Vec2 q) { return p.x * q.y - p.y * q.x; }
Vec2 along(const Segment &s, double t) { return {s.a.x + t * (s.b.x - s.a.x), s.a.y + t * (s.b.y - s.a.y)}; }

// How far along the segment the foot of p lies, held inside it; 0 for a segment without length.
double foot(Vec2 p, const Segment &s) {
    const Vec2 d = s.b - s.a;
    const double length2 = dot(d, d);
    return length2 > 0.0 ? std::clamp(dot(p - s.a, d) / length2, 0.0, 1.0) : 0.0;
}

double squared_to_point(Vec2 p, const Segment &s) {
    const Vec2 gap = p - along(s, foot(p, s));
    return dot(gap, gap);
}

// On which side of q's line the ends of p lie: areas with sign.
struct Sides {
    double a, b;
    bool differ() const { return (a > 0.0 && b < 0.0) || (a < 0.0 && b > 0.0); }
    double zero() const { return a / (a - b); } // how far along p the line of q is, when they differ
};

Sides sides(const Segment &p, const Segment &q) {
    const Vec2 d = q.b - q.a;
    return {cross(d, p.a - q.a), cross(d, p.b - q.a)};
}

// Strict crossing: both ends of each lie on different sides of the other. Touching and overlapping
// segments are not meant, the distances of their ends are exact already.
bool cross_each_other(const Segment &p, const Segment &q) {
    return sides(p, q).differ() && sides(q, p).differ();
}

Closest crossing(const Segment &p, const Segment &q) {
    const double t = sides(p, q).zero();
    const Vec2 at = along(p, t);
    return {at, at, t, sides(q, p).zero(), 0.0};
}

Closest swapped(const Closest &c) {
    return {c.on_second, c.on_first, c.along_second, c.along_first, c.distance_mm};
}

Closest from_end(const Segment &first, double end, const Segment &second) {
    Closest c = closest_point(end == 0.0 ? first.a : first.b, second);
    c.along_first = end;
    return c;
}

} // namespace

Closest closest_point(Vec2 p, const Segment &segment) {
    const double t = foot(p, segment);
    const Vec2 q = along(segment, t);
    return {p, q, 0.0, t, std::hypot(p.x - q.x, p.y - q.y)};
}

Closest closest_points(const Segment &first, const Segment &second) {
    if (cross_each_other(first, second)) return crossing(first, second);
    // segments that do not cross come closest at an end of one of them
    Closest best = from_end(first, 0.0, second);
    for (const Closest &c : {from_end(first, 1.0, second), swapped(from_end(second, 0.0, first)),
                             swapped(from_end(second, 1.0, first))})
        if (c.distance_mm < best.distance_mm) best = c;
    return best;
}

double point_segment_distance(Vec2 p, const Segment &segment) {
    return std::sqrt(squared_to_point(p, segment));
}

double segment_distance(const Segment &first, const Segment &second) {
    if (cross_each_other(first, second)) return 0.0;
    const double nearest2 = std::min({squared_to_point(first.a, second), squared_to_point(first.b, second),
                                      squared_to_point(second.a, first), squared_to_point(second.b, first)});
    return std::sqrt(nearest2);
}

Segment beta_segment(const Arm &arm, double from_mm, double to_mm, Angles angles) {
    const Vec2 e = elbow(arm, angles.alpha_rad);
    const double turn = angles.alpha_rad + arm.alpha_off_rad + angles.beta_rad + arm.beta_off_rad;
    const Vec2 u{std::cos(turn), std::sin(turn)};
    return {{e.x + from_mm * u.x, e.y + from_mm * u.y}, {e.x + to_mm * u.x, e.y + to_mm * u.y}};
}

} // namespace fl
