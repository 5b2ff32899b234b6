#include "motion/descent.hpp"

#include <cmath>

namespace fl::planning {
namespace {

// A turn costs every positioner time, so it costs more than whatever else there is.
constexpr int turn_cost = 8, apart_cost = 4, short_cost = 1;

int cost(const Descent &d, double usual_rad) {
    const int low = (d.above.alpha_rad < usual_rad) + (d.above.beta_rad < usual_rad);
    return turn_cost * d.last_turn() + apart_cost * (d.alpha_turn != d.beta_turn) + short_cost * low;
}

} // namespace

List<RatedDescent> descents(double usual_rad, double least_rad, int turns) {
    List<double> heights{usual_rad};
    if (least_rad < usual_rad) heights.push_back(least_rad);
    if (usual_rad == 0.0) turns = 1;
    List<RatedDescent> out;
    for (const double alpha : heights)
        for (const double beta : heights)
            for (int turn = 0; turn < turns * turns; ++turn) {
                const Descent d{{alpha, beta}, turn % turns, turn / turns};
                out.push_back({d, cost(d, usual_rad)});
            }
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
    leg.bulge_mm = (std::abs(body.arm.l_alpha_mm) * alpha * alpha + body.far_mm() * both * both) / 8.0;
    measure_displacement_bound(leg);
    return leg;
}

Legs::Legs(const ArmBody &body, Angles rest) : rest_(approach_leg(body, rest, {}, {})) {}

Legs::Legs(const ArmBody &body, Angles goal, const Descent &descent) : Legs(body, goal) {
    if (descent.above.alpha_rad == 0.0 && descent.above.beta_rad == 0.0) return;
    for (int turn = 0; turn <= descent.last_turn(); ++turn)
        turns_.push_back(approach_leg(body, goal, descent.left(turn), descent.left(turn + 1)));
}

bool stay_apart(const Legs &p, const Legs &q, double need_mm) {
    const int turns = std::max({p.turns(), q.turns(), 1});
    for (int turn = 0; turn < turns; ++turn)
        if (!stay_apart(p.at(turn), q.at(turn), need_mm)) return false;
    return true;
}

} // namespace fl::planning
