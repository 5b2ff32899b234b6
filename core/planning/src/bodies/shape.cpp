#include "bodies/shape.hpp"

#include <algorithm>

namespace fl::planning {
Segment Shape::place(const Limb &limb, const Segment &line) const { return placed(limb, pose(line)); }

bool limbs_within(const SweptArm &p, const Segment &p_line, const SweptArm &q, const Segment &q_line,
                  double need_mm) {
    const PlacedLimbs mine(p, p_line), theirs(q, q_line);
    return !all_limbs(Limbs(p), Limbs(q), need_mm, [&](int a, int b, double need) {
        return squared_distance(mine.at(a), theirs.at(b)) >= need * need;
    });
}

bool apart_at_first(const SweptArm &p, const SweptArm &q, double need_mm) {
    if (p.shape != nullptr || q.shape != nullptr) return !limbs_within(p, p.at[0], q, q.at[0], need_mm);
    return distance(p.at[0], q.at[0]) >= need_mm + p.extra_mm + q.extra_mm;
}

SweptArm resting_obstacle(const Capsule &obstacle) {
    SweptArm rest = resting_arm(obstacle.line);
    rest.layers = obstacle.layers;
    return rest;
}

double limbs_move_mm(const SweptArm &body, const Segment &from, const Segment &to) {
    double most = std::max(length(to.a - from.a), length(to.b - from.b));
    const Limbs limbs(body);
    for (int k = 0; k < limbs.size(); ++k) {
        const Segment before = limbs.at(k, from), after = limbs.at(k, to);
        most = std::max({most, length(after.a - before.a), length(after.b - before.b)});
    }
    return most;
}

namespace {

// A limb at one place, with what is asked of it for each limb of another body.
struct PlacedLimb {
    Segment line;
    Vec2 centre;
    double squared_mm2 = 0.0; // length
    double extra_mm = 0.0;
    Layers layers = 0;
    bool on_alpha = false;
    PlacedLimb() = default;
    PlacedLimb(const Limbs &limbs, int k, const Segment &at)
        : line(at), centre(middle(at.a, at.b)), extra_mm(limbs.extra_mm(k)), layers(limbs.layers(k)),
          on_alpha(limbs.on_alpha(k)) {
        const Vec2 along = at.b - at.a;
        squared_mm2 = dot(along, along);
    }
    bool may_touch(const PlacedLimb &other) const {
        return (layers & other.layers) != 0 && !(on_alpha && other.on_alpha);
    }
};

// Whether the circles around two lines are so far apart: by their squares alone, (x + y)^2 <= 2 (x^2 + y^2).
bool circles_apart(const PlacedLimb &p, const PlacedLimb &q, double need_mm) {
    const Vec2 gap = p.centre - q.centre;
    const double ways = 0.5 * (p.squared_mm2 + q.squared_mm2); // square of both half lengths, at most
    return dot(gap, gap) >= 2.0 * (ways + need_mm * need_mm);
}

bool limb_steps_apart(const SweptArm &p, int a, const SweptArm &q, int b, double need_mm,
                      ChordsTest chords_are_apart) {
    Segment one[quarters + 1], other[quarters + 1];
    const Limbs mine(p), theirs(q);
    for (int k = 0; k <= quarters; ++k) {
        one[k] = mine.at(a, p.at[k]);
        other[k] = theirs.at(b, q.at[k]);
    }
    return chords_are_apart(one, other, need_mm);
}

} // namespace

namespace {

constexpr int at_once = 16; // limbs of one body; more are looked at in turns

// Whether one limb stays apart from some of another body.
class LimbTest {
  public:
    LimbTest(const SweptArm &p, const SweptArm &q, double need_mm, ChordsTest chords)
        : p_(p), q_(q), mine_(p), theirs_(q), need_mm_(need_mm + p.bulge_mm + q.bulge_mm),
          ways_mm_(p.displacement_bound_mm + q.displacement_bound_mm), chords_are_apart_(chords) {}

    bool run() {
        const PlacedLimbs mine(p_, p_.at[2]), theirs(q_, q_.at[2]);
        for (first_ = 0; first_ < theirs_.size(); first_ += at_once) {
            const int end = std::min(first_ + at_once, theirs_.size());
            for (int b = first_; b < end; ++b) some_[b - first_] = PlacedLimb(theirs_, b, theirs.at(b));
            for (int a = 0; a < mine_.size(); ++a)
                if (!apart_from_some(a, PlacedLimb(mine_, a, mine.at(a)), end)) return false;
        }
        return true;
    }

  private:
    bool apart_from_some(int a, const PlacedLimb &one, int end) const {
        for (int b = first_; b < end; ++b)
            if (one.may_touch(some_[b - first_]) && !apart(a, one, b, some_[b - first_])) return false;
        return true;
    }
    bool apart(int a, const PlacedLimb &one, int b, const PlacedLimb &other) const {
        const double need = need_mm_ + one.extra_mm + other.extra_mm, clear = need + ways_mm_;
        if (circles_apart(one, other, clear)) return true;
        const double d2 = squared_distance(one.line, other.line);
        if (d2 >= clear * clear) return true;
        return d2 >= need * need && limb_steps_apart(p_, a, q_, b, need, chords_are_apart_);
    }

    const SweptArm &p_, &q_;
    Limbs mine_, theirs_;
    double need_mm_, ways_mm_;
    ChordsTest chords_are_apart_;
    int first_ = 0;
    PlacedLimb some_[at_once]; // theirs, from the first on
};

} // namespace

bool limbs_apart(const SweptArm &p, const SweptArm &q, double need_mm, ChordsTest chords_are_apart) {
    return LimbTest(p, q, need_mm, chords_are_apart).run();
}

} // namespace fl::planning
