#include "fiberloom/arm.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fl {
namespace {

constexpr double two_pi = 2.0 * std::numbers::pi;

Vec2 rotate(Vec2 v, double angle_rad) {
    const double c = std::cos(angle_rad), s = std::sin(angle_rad);
    return {c * v.x - s * v.y, s * v.x + c * v.y};
}

// The smallest angle of the class `angle + k 2 pi` that is not below `low`.
double first_turn(double angle_rad, double low_rad) {
    const double from_low = std::remainder(angle_rad - low_rad, two_pi);
    return low_rad + (from_low < -limit_tolerance_rad ? from_low + two_pi : from_low);
}

void add_turns(Solutions &out, Angles raw, const Limits &limits) {
    const double beta = first_turn(raw.beta_rad, limits.beta_min_rad);
    if (beta > limits.beta_max_rad + limit_tolerance_rad) return;
    for (double alpha = first_turn(raw.alpha_rad, limits.alpha_min_rad);
         alpha <= limits.alpha_max_rad + limit_tolerance_rad && out.count < Solutions::max_count;
         alpha += two_pi)
        out.angles[static_cast<size_t>(out.count++)] = {alpha, beta};
}

} // namespace

Vec2 elbow(const Arm &arm, double alpha_rad) {
    const Vec2 e = rotate({arm.l_alpha_mm, 0.0}, alpha_rad + arm.alpha_off_rad);
    return {arm.centre_mm.x + e.x, arm.centre_mm.y + e.y};
}

Vec2 forward(const Arm &arm, Vec2 point_mm, Angles angles) {
    const Vec2 e = elbow(arm, angles.alpha_rad);
    const Vec2 p =
        rotate(point_mm, angles.alpha_rad + arm.alpha_off_rad + angles.beta_rad + arm.beta_off_rad);
    return {e.x + p.x, e.y + p.y};
}

Solutions inverse(const Arm &arm, Vec2 point_mm, Vec2 target_mm, const Limits &limits) {
    const double l_a = arm.l_alpha_mm, l_b = std::hypot(point_mm.x, point_mm.y);
    const double psi = std::atan2(point_mm.y, point_mm.x);
    const Vec2 d = {target_mm.x - arm.centre_mm.x, target_mm.y - arm.centre_mm.y};
    const double inner = std::abs(l_a - l_b), outer = l_a + l_b;
    const double reach = std::hypot(d.x, d.y);

    Solutions out;
    out.gap_mm = std::max({reach - outer, inner - reach, 0.0});
    if (out.gap_mm > edge_tolerance_mm) return out;
    out.gap_mm = 0.0;
    // On the edge the cosine leaves [-1, 1] by rounding only. The half-angle form of the law of
    // cosines keeps its digits there, where acos loses half of them.
    const double r = std::clamp(reach, inner, outer);
    const double stretch = std::max((outer - r) * (outer + r), 0.0);
    const double fold = std::max((r - inner) * (r + inner), 0.0);
    const double bend = 2.0 * std::atan2(std::sqrt(stretch), std::sqrt(fold)); // elbow, [0, pi]
    const double direction = std::atan2(d.y, d.x);
    // angle at the centre between the alpha arm and the target
    const double xi = std::atan2(l_b * std::sin(bend), l_a + l_b * std::cos(bend));

    const bool straight = stretch == 0.0 || fold == 0.0;
    for (double side : {1.0, -1.0}) {
        if (side < 0.0 && straight) break; // both elbows coincide
        add_turns(out, {direction - side * xi - arm.alpha_off_rad, side * bend - psi - arm.beta_off_rad},
                  limits);
    }
    return out;
}

std::array<double, 4> jacobian(const Arm &arm, Vec2 point_mm, Angles angles) {
    const Vec2 tip = forward(arm, point_mm, angles);
    const Vec2 e = elbow(arm, angles.alpha_rad);
    return {-(tip.y - arm.centre_mm.y), -(tip.y - e.y), tip.x - arm.centre_mm.x, tip.x - e.x};
}

} // namespace fl
