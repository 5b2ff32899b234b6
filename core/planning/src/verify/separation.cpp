#include "verify/separation.hpp"

namespace fl::planning {
namespace {

// Bounds may be off by this part of what is allowed, or a gap that rests could use all of it up.
constexpr double sharp = 0.125;
constexpr int most_looks = 2'000'000; // a motion that needs more is not proven
constexpr int deepest = 60;           // halvings; the bounds settle long before
// A deeper breach than the one found is looked for if it may be deeper by this, or by this part of it.
constexpr double depth_true_mm = 1e-5, depth_true_part = 0.02;

double cross(Vec2 a, Vec2 b) { return a.x * b.y - a.y * b.x; }
Vec2 from_to(Vec2 a, Vec2 b) { return {b.x - a.x, b.y - a.y}; }

// How far a point lies to the left of the line through a segment.
double left_of(const Segment &line, Vec2 point) {
    const Vec2 along = from_to(line.a, line.b);
    return cross(along, from_to(line.a, point)) / std::hypot(along.x, along.y);
}

} // namespace

// Shifts that leave the segments in touch fill a parallelogram; its edges are as far from no shift at all as
// the ends of each segment are from the line of the other.
double signed_distance(const Segment &p, const Segment &q) {
    const double apart = segment_distance(p, q);
    if (apart > 0.0) return apart;
    const double shifts[] = {left_of(p, q.a), left_of(p, q.b), left_of(q, p.a), left_of(q, p.b)};
    double least = 1e9;
    for (const double shift : shifts) least = std::min(least, std::abs(shift));
    return std::isfinite(least) ? -least : 0.0; // a point has no line; it can only touch
}

double Separation::gap_mm(double time_s) const { return bodies_.gap_mm(time_s, signed_distance); }

Separation::Moment Separation::look(double time_s) {
    const double gap = gap_mm(time_s);
    ++looks_;
    if (gap < smallest_mm_) {
        smallest_mm_ = gap;
        smallest_s_ = time_s;
    }
    return {time_s, gap, bodies_.travelled_mm(time_s)};
}

void Separation::prove() {
    const Moment first = look(0.0), last = look(end_s());
    highest_mm_ = seen_mm_ = first.gap_mm;
    last_mm_ = last.gap_mm;
    descend(first, last, 0);
}

void Separation::break_rule(double by_mm, double time_s) {
    if (by_mm <= closing_mm_) return;
    closing_mm_ = by_mm;
    closing_s_ = time_s;
}

// A moment that has been looked at, all before it being judged.
void Separation::judge(const Moment &at) {
    const double allowed = seen_mm_ < 0.0 ? seen_mm_ - slack_mm : -touching_mm;
    if (at.gap_mm < allowed) break_rule(std::min(seen_mm_, 0.0) - at.gap_mm, at.time_s);
    seen_mm_ = std::max(seen_mm_, at.gap_mm);
}

// Whether an interval keeps the rule whatever happens in it: no gap is below lower or above upper, and
// none is farther than fall below an earlier one of the same interval.
bool Separation::proven(double lower_mm, double upper_mm, double fall_mm) const {
    if (highest_mm_ >= 0.0) return lower_mm >= -touching_mm;
    const double fall_allowed = upper_mm < 0.0 ? slack_mm : touching_mm;
    return fall_mm <= sharp * fall_allowed && lower_mm >= highest_mm_ - slack_mm;
}

// From one moment to a later one the gap can do no more than the bodies travel. What is not needed to get
// from the one gap to the other can be spent on going down and up again: half of it is the deepest fall.
void Separation::descend(const Moment &from, const Moment &to, int depth) {
    const double way = to.travelled_mm - from.travelled_mm;
    const double fall = 0.5 * (way - (to.gap_mm - from.gap_mm));
    const double lower = from.gap_mm - fall, upper = from.gap_mm + way - fall;
    const bool good = proven(lower, upper, fall);
    const double worst = std::max(fall, std::min(highest_mm_, 0.0) - lower);
    const bool no_worse =
        closing_mm_ > 0.0 && worst <= closing_mm_ + std::max(depth_true_mm, depth_true_part * closing_mm_);
    if (good || no_worse || depth == deepest || looks_ > most_looks) {
        judge(to);
        if (!good && closing_mm_ == 0.0) // cannot be shown to be kept: it is not
            break_rule(std::max(worst, touching_mm), from.time_s);
        // once the rule is broken only the depth matters, and that is of gaps that were looked at
        highest_mm_ = closing_mm_ > 0.0 ? seen_mm_ : std::max(highest_mm_, upper);
        return;
    }
    const Moment middle = look(0.5 * (from.time_s + to.time_s));
    descend(from, middle, depth + 1);
    descend(middle, to, depth + 1);
}

} // namespace fl::planning
