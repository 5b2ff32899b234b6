#include "motion/descent.hpp"

#include <cmath>

namespace fl::planning {
namespace {

// A turn costs every positioner time, so it costs more than whatever else there is.
constexpr int turn_cost = 16, apart_cost = 4, hook_cost = 2, short_cost = 1;

int cost(const Descent &d, double usual_rad) {
    int out = turn_cost * d.last_turn() + apart_cost * (d.alpha.turn != d.beta.turn);
    for (const AxisDescent &axis : {d.alpha, d.beta})
        out += short_cost * (axis.height_rad < usual_rad) + hook_cost * axis.waits_at_goal;
    return out;
}

List<AxisDescent> axis_descents(const DescentRules &rules) {
    List<double> heights{rules.usual_rad};
    if (rules.least_rad < rules.usual_rad) heights.push_back(rules.least_rad);
    List<AxisDescent> out;
    for (const double height : heights)
        for (int turn = 0; turn < rules.turns; ++turn) {
            out.push_back({height, turn, false});
            if (turn > 0 && height == rules.least_rad && height <= rules.highest_hook_rad)
                out.push_back({height, turn, true});
        }
    return out;
}

} // namespace

List<RatedDescent> descents(const DescentRules &rules) {
    if (rules.usual_rad == 0.0) return {{}};
    const List<AxisDescent> axis = axis_descents(rules);
    List<RatedDescent> out;
    for (const AxisDescent &alpha : axis)
        for (const AxisDescent &beta : axis)
            out.push_back({{alpha, beta}, cost({alpha, beta}, rules.usual_rad)});
    std::stable_sort(out.begin(), out.end(),
                     [](const RatedDescent &p, const RatedDescent &q) { return p.cost < q.cost; });
    return out;
}

SweptArm approach_leg(const ArmBody &body, Angles goal, Angles from, Angles to) {
    SweptArm leg;
    for (int k = 0; k <= quarters; ++k) {
        const Angles above = between(to, from, static_cast<double>(quarters - k) / quarters);
        leg.at[k] = body.line(turn(goal.alpha_rad + above.alpha_rad + body.arm.alpha_off_rad),
                              turn(goal.beta_rad + above.beta_rad + body.arm.beta_off_rad));
    }
    const double alpha = (from.alpha_rad - to.alpha_rad) / quarters;
    const double both = alpha + (from.beta_rad - to.beta_rad) / quarters;
    const double far_mm = std::abs(body.arm.l_alpha_mm) * alpha * alpha + body.far_mm * both * both;
    leg.bulge_mm = std::max(far_mm, body.alpha_far_mm * alpha * alpha) / 8.0;
    leg.extra_mm = body.extra_mm;
    leg.shape = body.shape;
    measure_displacement_bound(leg);
    return leg;
}

Legs::Legs(const ArmBody &body, Angles rest) : rest_(approach_leg(body, rest, {}, {})) {}

Legs::Legs(const ArmBody &body, Angles goal, const Descent &descent) : Legs(body, goal) {
    if (descent.alpha.height_rad == 0.0 && descent.beta.height_rad == 0.0) return;
    for (int turn = 0; turn <= descent.last_turn(); ++turn)
        turns_.push_back(approach_leg(body, goal, descent.above(turn), descent.above(turn + 1)));
}

bool stay_apart(const Legs &p, const Legs &q, double need_mm) {
    const int turns = std::max({p.turns(), q.turns(), 1});
    for (int turn = 0; turn < turns; ++turn)
        if (!stay_apart(p.at(turn), q.at(turn), need_mm)) return false;
    return true;
}

} // namespace fl::planning
