#include "fiberloom/conflicts.hpp"
#include "bodies/body.hpp"
#include "motion/descent.hpp"
#include "motion/near_pairs.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

SweptArm leg(const ArmBody &body, Angles goal, double approach_rad) {
    return approach_leg(body, goal, {approach_rad, approach_rad}, {});
}

PositionerIndex place(const std::vector<int> &rows, std::size_t k) { return PositionerIndex(rows[k]); }

} // namespace

std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          double approach_rad) {
    const ArmBodies arms(bodies);
    List<SweptArm> legs;
    for (const Angles goal : goals)
        legs.push_back(leg(arms[PositionerIndex(legs.size())], goal, approach_rad));
    std::vector<std::array<int, 2>> out;
    for (const auto &[i, j, gap] : near_pairs(arms.reaches(), 2.0 * arms.radius_mm()))
        if (!stay_apart(legs[i], legs[j], 2.0 * arms.radius_mm())) out.push_back({i, j});
    std::sort(out.begin(), out.end());
    return out;
}

std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<int> &rows,
                                    const std::vector<Angles> &goals, double approach_rad) {
    const ArmBodies arms(bodies);
    std::vector<std::uint8_t> out;
    for (std::size_t k = 0; k < goals.size(); ++k) {
        const SweptArm down = leg(arms[place(rows, k)], goals[k], approach_rad);
        out.push_back(std::all_of(bodies.obstacles.begin(), bodies.obstacles.end(), [&](const Capsule &o) {
            return o.owner == rows[k] ||
                   stay_apart(down, resting_obstacle(o), arms.radius_mm() + o.radius_mm);
        }));
    }
    return out;
}

std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const PlacesOf &first, const PlacesOf &second,
                                      double approach_rad) {
    const ArmBodies arms(bodies);
    std::vector<std::uint8_t> out;
    for (std::size_t k = 0; k < first.rows.size(); ++k)
        out.push_back(stay_apart(leg(arms[place(first.rows, k)], first.goals[k], approach_rad),
                                 leg(arms[place(second.rows, k)], second.goals[k], approach_rad),
                                 2.0 * arms.radius_mm()));
    return out;
}

} // namespace fl::planning
