#include "fiberloom/conflicts.hpp"
#include "motion/descent.hpp"
#include "motion/near_pairs.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

SweptArm leg(const Bodies &bodies, const Arm &arm, Angles goal, double approach_rad) {
    return approach_leg(arm_body(bodies, arm), goal, {approach_rad, approach_rad}, {});
}

} // namespace

std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          double approach_rad) {
    List<SweptArm> legs;
    List<Reach> reaches;
    for (const Arm &arm : bodies.arms) {
        legs.push_back(leg(bodies, arm, row(goals, PositionerIndex(legs.size())), approach_rad));
        reaches.push_back({arm.centre_mm, arm_body(bodies, arm).reach_mm()});
    }
    std::vector<std::array<int, 2>> out;
    for (const auto &[i, j, gap] : near_pairs(reaches, 2.0 * bodies.radius_mm))
        if (!stay_apart(legs[i], legs[j], 2.0 * bodies.radius_mm)) out.push_back({i, j});
    std::sort(out.begin(), out.end());
    return out;
}

std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<Angles> &goals,
                                    double approach_rad) {
    std::vector<std::uint8_t> out;
    for (std::size_t i = 0; i < goals.size(); ++i) {
        const SweptArm down = leg(bodies, bodies.arms[i], goals[i], approach_rad);
        out.push_back(std::all_of(bodies.obstacles.begin(), bodies.obstacles.end(), [&](const Capsule &o) {
            return stay_apart(down, resting_arm(o.line), bodies.radius_mm + o.radius_mm);
        }));
    }
    return out;
}

std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const std::vector<Arm> &others,
                                      const std::vector<Angles> &p, const std::vector<Angles> &q,
                                      double approach_rad) {
    std::vector<std::uint8_t> out;
    for (std::size_t k = 0; k < others.size(); ++k)
        out.push_back(stay_apart(leg(bodies, bodies.arms[k], p[k], approach_rad),
                                 leg(bodies, others[k], q[k], approach_rad), 2.0 * bodies.radius_mm));
    return out;
}

} // namespace fl::planning
