#include "fiberloom/conflicts.hpp"
#include "motion.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

double reach(const Bodies &b, const Arm &arm) {
    return std::abs(arm.l_alpha_mm) + std::max(std::abs(b.from_mm), std::abs(b.to_mm));
}

Piece leg(const Bodies &b, const Arm &arm, Angles goal, double approach_rad) {
    return approach_leg(arm, b.from_mm, b.to_mm, goal, approach_rad);
}

} // namespace

std::vector<std::array<int, 2>> conflicts(const Bodies &bodies, const std::vector<Angles> &goals,
                                          double approach_rad) {
    std::vector<Piece> legs;
    std::vector<std::pair<double, int>> by_x;
    double widest = 0.0;
    for (size_t i = 0; i < goals.size(); ++i) {
        legs.push_back(leg(bodies, bodies.arms[i], goals[i], approach_rad));
        by_x.emplace_back(bodies.arms[i].centre_mm.x, static_cast<int>(i));
        widest = std::max(widest, reach(bodies, bodies.arms[i]) + bodies.radius_mm);
    }
    std::sort(by_x.begin(), by_x.end());
    std::vector<std::array<int, 2>> out;
    for (size_t a = 0; a < by_x.size(); ++a)
        for (size_t b = a + 1; b < by_x.size() && by_x[b].first - by_x[a].first <= 2.0 * widest; ++b) {
            const int i = std::min(by_x[a].second, by_x[b].second),
                      j = std::max(by_x[a].second, by_x[b].second);
            if (!stay_apart(legs[static_cast<size_t>(i)], legs[static_cast<size_t>(j)],
                            2.0 * bodies.radius_mm))
                out.push_back({i, j});
        }
    std::sort(out.begin(), out.end());
    return out;
}

std::vector<std::uint8_t> static_ok(const Bodies &bodies, const std::vector<Angles> &goals,
                                    double approach_rad) {
    std::vector<std::uint8_t> out;
    for (size_t i = 0; i < goals.size(); ++i) {
        const Piece down = leg(bodies, bodies.arms[i], goals[i], approach_rad);
        out.push_back(std::all_of(bodies.obstacles.begin(), bodies.obstacles.end(), [&](const Capsule &o) {
            return stay_apart(down, standing(o.line), bodies.radius_mm + o.radius_mm);
        }));
    }
    return out;
}

std::vector<std::uint8_t> pairs_clear(const Bodies &bodies, const std::vector<Arm> &others,
                                      const std::vector<Angles> &p, const std::vector<Angles> &q,
                                      double approach_rad) {
    std::vector<std::uint8_t> out;
    for (size_t k = 0; k < others.size(); ++k)
        out.push_back(stay_apart(leg(bodies, bodies.arms[k], p[k], approach_rad),
                                 leg(bodies, others[k], q[k], approach_rad), 2.0 * bodies.radius_mm));
    return out;
}

} // namespace fl::planning
