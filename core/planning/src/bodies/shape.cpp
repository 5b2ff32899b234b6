#include "bodies/shape.hpp"

namespace fl::planning {
namespace {

Segment turned(Vec2 at, Vec2 x, const Segment &s) {
    return {{at.x + s.a.x * x.x - s.a.y * x.y, at.y + s.a.x * x.y + s.a.y * x.x},
            {at.x + s.b.x * x.x - s.b.y * x.y, at.y + s.b.x * x.y + s.b.y * x.x}};
}

} // namespace

Segment Shape::place(const Limb &limb, const Segment &line) const {
    const Vec2 from = limb.on_alpha ? centre_mm : line.a, to = limb.on_alpha ? line.a : line.b;
    const double length_mm = limb.on_alpha ? l_alpha_mm : line_mm;
    return turned(from, {(to.x - from.x) / length_mm, (to.y - from.y) / length_mm}, limb.line);
}

bool limbs_within(const SweptArm &p, const Segment &p_line, const SweptArm &q, const Segment &q_line,
                  double need_mm) {
    const Limbs mine(p), theirs(q);
    return !all_limbs(mine, theirs, need_mm, [&](int a, int b, double need) {
        return squared_distance(mine.at(a, p_line), theirs.at(b, q_line)) >= need * need;
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

bool limbs_apart(const SweptArm &p, const SweptArm &q, double need_mm, ChordsTest chords_are_apart) {
    const Limbs mine(p), theirs(q);
    const double ways = p.displacement_bound_mm + q.displacement_bound_mm;
    return all_limbs(mine, theirs, need_mm + p.bulge_mm + q.bulge_mm, [&](int a, int b, double need) {
        const double mid = distance(mine.at(a, p.at[2]), theirs.at(b, q.at[2]));
        if (mid < need) return false;
        if (mid - ways >= need) return true;
        Segment one[quarters + 1], other[quarters + 1];
        for (int k = 0; k <= quarters; ++k) {
            one[k] = mine.at(a, p.at[k]);
            other[k] = theirs.at(b, q.at[k]);
        }
        return chords_are_apart(one, other, need);
    });
}

} // namespace fl::planning
