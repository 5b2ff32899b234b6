#include "points/own_knots.hpp"

#include <algorithm>

namespace fl::planning {

double angle_at(const Knots &knots, int quarter) {
    const auto after = [](int q, const Knot &k) { return q < k.quarter; };
    const auto next = std::upper_bound(knots.begin(), knots.end(), quarter, after);
    if (next == knots.begin()) return knots.front().angle_rad;
    if (next == knots.end()) return knots.back().angle_rad;
    const Knot &from = *(next - 1), &to = *next;
    const double part = double(quarter - from.quarter) / (to.quarter - from.quarter);
    return from.angle_rad + part * (to.angle_rad - from.angle_rad);
}

Motion motion_along(const OwnKnots &own, double quarter_s) {
    List<int> moments;
    for (const Knots *knots : {&own.alpha, &own.beta})
        for (const Knot &knot : *knots) moments.push_back(knot.quarter);
    std::sort(moments.begin(), moments.end());
    Motion out;
    for (int k = 0; k < moments.size(); ++k) {
        if (k > 0 && moments[k] == moments[k - 1]) continue;
        out.time_s.push_back(moments[k] * quarter_s);
        out.angles.push_back({angle_at(own.alpha, moments[k]), angle_at(own.beta, moments[k])});
    }
    return out;
}

} // namespace fl::planning
