// One time step of a beta arm, and the test whether two of them stay apart during all of it.
//
// A step is cut into four quarters; within a quarter both angles run straight in time. The ends of the arm's
// centre line are kept at the five borders. Between borders an end follows an arc, which leaves its
// chord by at most `bulge_mm`; the test treats ends as moving on chords and adds the bulges.
#pragma once

#include "fiberloom/distance.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace fl::planning {

inline constexpr int quarters = 4;

struct Piece {
    std::array<Segment, quarters + 1> at{};
    double sway_mm = 0.0;  // no point of the arm gets farther than this from its place at mid-step
    double bulge_mm = 0.0; // arc against chord, within a quarter
};

inline Vec2 operator-(Vec2 p, Vec2 q) { return {p.x - q.x, p.y - q.y}; }
inline double dot(Vec2 p, Vec2 q) { return p.x * q.x + p.y * q.y; }
inline double cross(Vec2 p, Vec2 q) { return p.x * q.y - p.y * q.x; }
inline double length(Vec2 p) { return std::sqrt(dot(p, p)); }
inline Vec2 middle(Vec2 p, Vec2 q) { return {0.5 * (p.x + q.x), 0.5 * (p.y + q.y)}; }
inline Segment middle(const Segment &p, const Segment &q) { return {middle(p.a, q.a), middle(p.b, q.b)}; }

// Squared distance of two segments, 0 where they cross.
double squared_distance(const Segment &p, const Segment &q);

inline double distance(const Segment &p, const Segment &q) { return std::sqrt(squared_distance(p, q)); }

// How far apart the ends of two segments move during an interval, at most: by so much, and no more, can
// the distance of any two of their points change.
double relative_way(const Segment &p0, const Segment &p1, const Segment &q0, const Segment &q1);

// True only if the centre lines stay at least `need_mm` apart during the whole step.
bool stay_apart(const Piece &p, const Piece &q, double need_mm);

// A body that does not move, as a step.
Piece standing(const Segment &line);

// Fills in sway_mm from the borders and the bulge.
void measure_sway(Piece &piece);

} // namespace fl::planning
