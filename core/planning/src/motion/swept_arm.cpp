#include "motion/swept_arm.hpp"

#include "bodies/shape.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

constexpr int most_halvings = 5;
constexpr int most_late_halvings = 5; // of the one and of the other arm together

TwoLines two_lines(const Segment &p, const Segment &q) { return {p, q, distance(p, q)}; }

// Whether two segments whose ends run on straight lines stay apart between two moments. Halves the interval
// until the answer is sure.
bool chords_apart(const TwoLines &from, const TwoLines &to, double need, int halvings) {
    const double d0 = from.distance_mm, d1 = to.distance_mm;
    if (d0 < need || d1 < need) return false;
    if (d0 + d1 - relative_displacement(from, to) >= 2.0 * need) return true;
    if (halvings == 0) return false;
    const TwoLines half = two_lines(middle(from.p, to.p), middle(from.q, to.q));
    return chords_apart(from, half, need, halvings - 1) && chords_apart(half, to, need, halvings - 1);
}

// A segment whose ends run on straight lines.
struct Chords {
    Segment from, to;
    Segment middle_line() const { return middle(from, to); }
    // How far its points get from there.
    double displacement_mm() const { return 0.5 * std::max(length(to.a - from.a), length(to.b - from.b)); }
    Chords half(int which) const {
        const Segment mid = middle_line();
        return which == 0 ? Chords{from, mid} : Chords{mid, to};
    }
};

// Whether two such segments stay apart at any two moments. Halves the one that moves farther.
bool ever_apart(const Chords &p, const Chords &q, double need, int halvings) {
    const double mid = distance(p.middle_line(), q.middle_line());
    if (mid < need) return false;
    const double way_p = p.displacement_mm(), way_q = q.displacement_mm();
    if (mid - way_p - way_q >= need) return true;
    if (halvings == 0) return false;
    if (way_p >= way_q)
        return ever_apart(p.half(0), q, need, halvings - 1) && ever_apart(p.half(1), q, need, halvings - 1);
    return ever_apart(p, q.half(0), need, halvings - 1) && ever_apart(p, q.half(1), need, halvings - 1);
}

} // namespace

double relative_displacement(const TwoLines &from, const TwoLines &to) {
    const Vec2 pa = to.p.a - from.p.a, pb = to.p.b - from.p.b;
    const Vec2 qa = to.q.a - from.q.a, qb = to.q.b - from.q.b;
    const Vec2 aa = pa - qa, ab = pa - qb, ba = pb - qa, bb = pb - qb;
    return std::sqrt(std::max(std::max(dot(aa, aa), dot(ab, ab)), std::max(dot(ba, ba), dot(bb, bb))));
}

namespace {

// Two lines at three borders: in the middle of a step, a quarter and a half of it from there.
struct HalfStep {
    TwoLines middle, border, end;
    double ways_mm() const {
        return relative_displacement(middle, border) + relative_displacement(border, end);
    }
};

// The same for two quarters. Most are seen to be apart without the border between, many by their middle
// alone.
bool half_apart(HalfStep half, double need) {
    const double ways = half.ways_mm();
    if (half.middle.distance_mm - ways >= need) return true;
    half.end.distance_mm = distance(half.end.p, half.end.q);
    if (half.end.distance_mm < need) return false;
    if (half.middle.distance_mm + half.end.distance_mm - ways >= 2.0 * need) return true;
    half.border.distance_mm = distance(half.border.p, half.border.q);
    return chords_apart(half.middle, half.border, need, most_halvings) &&
           chords_apart(half.border, half.end, need, most_halvings);
}

// With the distance in the middle of the step.
bool chords_apart_around(const Segment *p, const Segment *q, double middle_mm, double need) {
    static_assert(quarters == 4);
    const TwoLines middle{p[2], q[2], middle_mm};
    return middle_mm >= need && half_apart({middle, {p[1], q[1]}, {p[0], q[0]}}, need) &&
           half_apart({middle, {p[3], q[3]}, {p[4], q[4]}}, need);
}

} // namespace

bool chords_stay_apart(const Segment *p, const Segment *q, double need_mm) {
    return chords_apart_around(p, q, distance(p[2], q[2]), need_mm);
}

bool chords_ever_apart(const Segment *p, const Segment *q, double need_mm) {
    for (int k = 0; k < quarters; ++k)
        for (int m = 0; m < quarters; ++m)
            if (!ever_apart(Chords{p[k], p[k + 1]}, Chords{q[m], q[m + 1]}, need_mm, most_late_halvings))
                return false;
    return true;
}

namespace {

// Whether two bodies stay apart, by a test of lines that may come near. mid: of their centre lines, mm.
inline bool bodies_apart(const SweptArm &p, const SweptArm &q, double mid, double need_mm,
                         ChordsTest chords_are_apart) {
    const double need = need_mm + p.bulge_mm + q.bulge_mm + p.extra_mm + q.extra_mm;
    const bool near = mid < need, shaped = p.shape != nullptr || q.shape != nullptr;
    if (near && !shaped) return (p.layers & q.layers) == 0;
    if (mid - p.displacement_bound_mm - q.displacement_bound_mm >= need) return true;
    if (shaped) return limbs_apart(p, q, need_mm, chords_are_apart);
    if ((p.layers & q.layers) == 0) return true;
    return chords_are_apart == chords_stay_apart ? chords_apart_around(p.at, q.at, mid, need)
                                                 : chords_are_apart(p.at, q.at, need);
}

} // namespace

bool stay_apart(const SweptArm &p, const SweptArm &q, double need_mm) {
    return stay_apart(p, q, distance(p.at[2], q.at[2]), need_mm);
}

bool stay_apart(const SweptArm &p, const SweptArm &q, double middle_mm, double need_mm) {
    return bodies_apart(p, q, middle_mm, need_mm, chords_stay_apart);
}

bool ever_apart(const SweptArm &p, const SweptArm &q, double need_mm) {
    return ever_apart(p, q, distance(p.at[2], q.at[2]), need_mm);
}

bool ever_apart(const SweptArm &p, const SweptArm &q, double middle_mm, double need_mm) {
    const bool rests = p.displacement_bound_mm == 0.0 || q.displacement_bound_mm == 0.0;
    return bodies_apart(p, q, middle_mm, need_mm, rests ? chords_stay_apart : chords_ever_apart);
}

SweptArm quarter_of(const SweptArm &swept, int quarter) {
    SweptArm out = swept;
    const Segment &from = swept.at[quarter], &to = swept.at[quarter + 1];
    const bool rests = length(to.a - from.a) == 0.0 && length(to.b - from.b) == 0.0;
    if (rests) out.bulge_mm = 0.0;
    const Segment half = middle(from, to);
    const Segment at[] = {from, middle(from, half), half, middle(half, to), to};
    std::copy(std::begin(at), std::end(at), out.at);
    measure_displacement_bound(out);
    return out;
}

SweptArm resting_arm(const Segment &line, double extra_mm, const Shape *shape) {
    SweptArm rest;
    std::fill(std::begin(rest.at), std::end(rest.at), line);
    rest.extra_mm = extra_mm;
    rest.shape = shape;
    return rest;
}

namespace {

// How far the ends of a line move from mid-step outwards.
double displacement(const Segment *at) {
    double bound = 0.0;
    for (int side : {-1, 1}) {
        double a = 0.0, b = 0.0; // how far the two ends move from mid-step outwards
        for (int k = 0; k < quarters / 2; ++k) {
            const Segment &from = at[2 + side * k], &to = at[2 + side * (k + 1)];
            a += length(to.a - from.a);
            b += length(to.b - from.b);
        }
        bound = std::max({bound, a, b});
    }
    return bound;
}

} // namespace

void measure_displacement_bound(SweptArm &swept) {
    double bound = displacement(swept.at);
    if (swept.shape != nullptr)
        for (const Limb &limb : swept.shape->limbs) {
            Segment at[quarters + 1];
            for (int k = 0; k <= quarters; ++k) at[k] = swept.shape->place(limb, swept.at[k]);
            bound = std::max(bound, displacement(at));
        }
    swept.displacement_bound_mm = bound + swept.bulge_mm;
}

} // namespace fl::planning
