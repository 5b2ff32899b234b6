#include "piece.hpp"

namespace fl::planning {
namespace {

// The distance of two segments whose ends run on straight lines from (p0, q0) to (p1, q1). d0 and d1
// are the distances at the ends of the interval. Halves the interval until the answer is sure.
bool chords_apart(const Segment &p0, const Segment &p1, const Segment &q0, const Segment &q1, double d0,
                  double d1, double need, int depth) {
    if (d0 < need || d1 < need) return false;
    if (d0 + d1 - relative_way(p0, p1, q0, q1) >= 2.0 * need) return true;
    if (depth == 0) return false;
    const Segment p = middle(p0, p1), q = middle(q0, q1);
    const double d = distance(p, q);
    return chords_apart(p0, p, q0, q, d0, d, need, depth - 1) &&
           chords_apart(p, p1, q, q1, d, d1, need, depth - 1);
}

} // namespace

double relative_way(const Segment &p0, const Segment &p1, const Segment &q0, const Segment &q1) {
    const Vec2 pa = p1.a - p0.a, pb = p1.b - p0.b, qa = q1.a - q0.a, qb = q1.b - q0.b;
    const Vec2 aa = pa - qa, ab = pa - qb, ba = pb - qa, bb = pb - qb;
    return std::sqrt(std::max(std::max(dot(aa, aa), dot(ab, ab)), std::max(dot(ba, ba), dot(bb, bb))));
}

bool stay_apart(const Piece &p, const Piece &q, double need_mm) {
    const double need = need_mm + p.bulge_mm + q.bulge_mm;
    std::array<double, quarters + 1> d;
    d[2] = distance(p.at[2], q.at[2]);
    if (d[2] < need) return false;
    if (d[2] - p.sway_mm - q.sway_mm >= need) return true;
    for (size_t k : {size_t{0}, size_t{1}, size_t{3}, size_t{4}}) d[k] = distance(p.at[k], q.at[k]);
    for (size_t k = 0; k < quarters; ++k)
        if (!chords_apart(p.at[k], p.at[k + 1], q.at[k], q.at[k + 1], d[k], d[k + 1], need, 5)) return false;
    return true;
}

Piece standing(const Segment &line) {
    Piece piece;
    piece.at.fill(line);
    return piece;
}

void measure_sway(Piece &piece) {
    double sway = 0.0;
    for (int side : {-1, 1}) {
        double a = 0.0, b = 0.0; // ways of the two ends, from mid-step outwards
        for (int k = 0; k < quarters / 2; ++k) {
            const auto from = static_cast<size_t>(2 + side * k), to = static_cast<size_t>(2 + side * (k + 1));
            a += length(piece.at[to].a - piece.at[from].a);
            b += length(piece.at[to].b - piece.at[from].b);
        }
        sway = std::max({sway, a, b});
    }
    piece.sway_mm = sway + piece.bulge_mm;
}

} // namespace fl::planning
