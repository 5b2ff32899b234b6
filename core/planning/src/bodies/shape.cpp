#include "bodies/shape.hpp"

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

// Whether the circles around two lines are so far apart: by their squares alone, (x + y)^2 <= 2 (x^2 + y^2).
bool circles_apart(const Segment &p, const Segment &q, double need_mm) {
    const Vec2 gap = middle(p.a, p.b) - middle(q.a, q.b), along = p.b - p.a, there = q.b - q.a;
    const double ways = 0.5 * (dot(along, along) + dot(there, there)); // square of both half lengths, at most
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

bool limbs_apart(const SweptArm &p, const SweptArm &q, double need_mm, ChordsTest chords_are_apart) {
    const PlacedLimbs mine(p, p.at[2]), theirs(q, q.at[2]);
    const double ways = p.displacement_bound_mm + q.displacement_bound_mm;
    return all_limbs(Limbs(p), Limbs(q), need_mm + p.bulge_mm + q.bulge_mm, [&](int a, int b, double need) {
        const Segment one = mine.at(a), other = theirs.at(b);
        const double clear = need + ways;
        if (circles_apart(one, other, clear)) return true;
        const double d2 = squared_distance(one, other);
        if (d2 >= clear * clear) return true;
        return d2 >= need * need && limb_steps_apart(p, a, q, b, need, chords_are_apart);
    });
}

} // namespace fl::planning
