#include "fiberloom/conflicts.hpp"
#include "bodies/body.hpp"
#include "motion/descent.hpp"
#include "motion/near_pairs.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

SweptArm leg(const ArmBody &body, Angles goal, Angles approach) {
    return approach_leg(body, goal, approach, {});
}

// Those of some rows alone: where few of many are looked at, the others cost no time.
Bodies picked(const Bodies &bodies, const std::vector<int> &rows) {
    Bodies out;
    for (const int i : rows) {
        out.arms.push_back(bodies.arms[static_cast<std::size_t>(i)]);
        out.parts.push_back(bodies.parts[static_cast<std::size_t>(i)]);
    }
    return out;
}

// The place of each of a list.
PositionerIndex nth(std::size_t k) { return PositionerIndex(static_cast<int>(k)); }

} // namespace

std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          Angles approach) {
    const ArmBodies arms(bodies);
    List<SweptArm> legs;
    for (const Angles goal : goals) legs.push_back(leg(arms[PositionerIndex(legs.size())], goal, approach));
    std::vector<std::array<int, 2>> out;
    for (const auto &[i, j, gap] : near_pairs(arms.reaches(), 2.0 * arms.radius_mm()))
        if (!stay_apart(legs[i], legs[j], 2.0 * arms.radius_mm())) out.push_back({i, j});
    std::sort(out.begin(), out.end());
    return out;
}

std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<int> &rows,
                                    const std::vector<Angles> &goals, Angles approach) {
    const Bodies some = picked(bodies, rows);
    const ArmBodies arms(some);
    std::vector<std::uint8_t> out;
    for (std::size_t k = 0; k < goals.size(); ++k) {
        const SweptArm down = leg(arms[nth(k)], goals[k], approach);
        out.push_back(std::all_of(bodies.obstacles.begin(), bodies.obstacles.end(), [&](const Capsule &o) {
            return o.owner == rows[k] ||
                   stay_apart(down, resting_obstacle(o), arms.radius_mm() + o.radius_mm);
        }));
    }
    return out;
}

std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const PlacesOf &first, const PlacesOf &second,
                                      Angles approach) {
    std::vector<int> rows = first.rows;
    rows.insert(rows.end(), second.rows.begin(), second.rows.end());
    const Bodies some = picked(bodies, rows);
    const ArmBodies arms(some);
    const std::size_t n = first.rows.size();
    std::vector<std::uint8_t> out;
    for (std::size_t k = 0; k < n; ++k)
        out.push_back(stay_apart(leg(arms[nth(k)], first.goals[k], approach),
                                 leg(arms[nth(n + k)], second.goals[k], approach), 2.0 * arms.radius_mm()));
    return out;
}

} // namespace fl::planning
