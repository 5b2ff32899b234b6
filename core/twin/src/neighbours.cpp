#include "fiberloom/twin/neighbours.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "fiberloom/twin/axis_group.hpp"

namespace fl::twin {
namespace {

constexpr double contact_mm_per_N = 0.01; // two steel cylinders of arm size, order of magnitude (assumed)
constexpr double metres = 1e-3;

Vec2 minus(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
double cross(Vec2 a, Vec2 b) { return a.x * b.y - a.y * b.x; }

// Away from the other body; where centre lines meet or cross, any direction that both agree on.
Vec2 away(Vec2 from, Vec2 to, double distance, bool first) {
    if (distance > 1e-9) return {(to.x - from.x) / distance, (to.y - from.y) / distance};
    return {first ? 1.0 : -1.0, 0.0};
}

} // namespace

Neighbours::Neighbours(std::vector<Arm> arms, std::vector<Obstacle> obstacles, Body body,
                       std::vector<Give> gives)
    : arms_(std::move(arms)), obstacles_(std::move(obstacles)), body_(body), gives_(std::move(gives)),
      near_arms_(arms_.size()), near_obstacles_(arms_.size()), next_look_(arms_.size(), 0) {
    find_neighbours();
}

double Neighbours::reach_mm(size_t i) const { return arms_[i].l_alpha_mm + body_.to_mm + body_.radius_mm; }

double Neighbours::approach_speed_mm_s(size_t i) const {
    const double *w = gives_[i].speed_limit_rad_s;
    return w[0] * (arms_[i].l_alpha_mm + body_.to_mm) + w[1] * body_.to_mm;
}

void Neighbours::find_neighbours() {
    const auto apart = [](Vec2 a, Vec2 b) { return std::hypot(a.x - b.x, a.y - b.y); };
    for (size_t i = 0; i < arms_.size(); ++i) {
        for (size_t j = 0; j < arms_.size(); ++j)
            if (j != i && apart(arms_[i].centre_mm, arms_[j].centre_mm) < reach_mm(i) + reach_mm(j))
                near_arms_[i].push_back(static_cast<uint32_t>(j));
        for (size_t k = 0; k < obstacles_.size(); ++k)
            if (point_segment_distance(arms_[i].centre_mm, obstacles_[k].centre_line_mm) <
                reach_mm(i) + obstacles_[k].radius_mm)
                near_obstacles_[i].push_back(static_cast<uint32_t>(k));
    }
}

Segment Neighbours::segment(size_t i, const Angles &angles) const {
    return beta_segment(arms_[i], body_.from_mm, body_.to_mm, angles);
}

// How far the arm gives way along the normal for one newton: levers squared times compliances, Eq. 5a.
double Neighbours::softness_mm_per_N(size_t i, const Angles &angles, const Contact &c) const {
    const double lever_a_m = metres * cross(minus(c.point_mm, arms_[i].centre_mm), c.normal);
    const double lever_b_m = metres * cross(minus(c.point_mm, elbow(arms_[i], angles.alpha_rad)), c.normal);
    const double *give = gives_[i].compliance_rad_per_Nm;
    return (lever_a_m * lever_a_m * give[0] + lever_b_m * lever_b_m * give[1]) / metres;
}

// J^T F. The depth is that of undeflected gears, so the force is known at once: all springs in series.
void Neighbours::add(Push &push, size_t i, const Angles &angles, const Contact &c,
                     double other_mm_per_N) const {
    const double force_N = c.depth_mm / (contact_mm_per_N + softness_mm_per_N(i, angles, c) + other_mm_per_N);
    push.torque_Nm[0] += force_N * metres * cross(minus(c.point_mm, arms_[i].centre_mm), c.normal);
    push.torque_Nm[1] +=
        force_N * metres * cross(minus(c.point_mm, elbow(arms_[i], angles.alpha_rad)), c.normal);
}

// Returns the seconds in which the two cannot touch.
double Neighbours::meet_arm(size_t i, size_t j, const std::vector<Angles> &angles, const Segment &mine,
                            Push &push, std::vector<uint32_t> &touched) const {
    const Closest c = closest_points(mine, segment(j, angles[j]));
    const double gap_mm = c.distance_mm - 2.0 * body_.radius_mm;
    if (gap_mm >= 0.0) return gap_mm / (approach_speed_mm_s(i) + approach_speed_mm_s(j));
    const Contact on_me = {c.on_first, away(c.on_second, c.on_first, c.distance_mm, i < j), -gap_mm};
    const Contact on_other = {c.on_second, {-on_me.normal.x, -on_me.normal.y}, -gap_mm};
    add(push, i, angles[i], on_me, softness_mm_per_N(j, angles[j], on_other));
    touched.push_back(static_cast<uint32_t>(j));
    return 0.0;
}

double Neighbours::meet_obstacle(size_t i, size_t k, const Angles &angles, const Segment &mine, Push &push,
                                 std::vector<uint32_t> &touched) const {
    const Closest c = closest_points(mine, obstacles_[k].centre_line_mm);
    const double gap_mm = c.distance_mm - body_.radius_mm - obstacles_[k].radius_mm;
    if (gap_mm >= 0.0) return gap_mm / approach_speed_mm_s(i);
    add(push, i, angles, {c.on_first, away(c.on_second, c.on_first, c.distance_mm, true), -gap_mm}, 0.0);
    touched.push_back(static_cast<uint32_t>(arms_.size() + k));
    return 0.0;
}

Push Neighbours::push(size_t i, const std::vector<Angles> &angles, uint64_t tick,
                      std::vector<uint32_t> &touched) {
    touched.clear();
    Push push;
    if (tick < next_look_[i]) return push;
    const Segment mine = segment(i, angles[i]);
    double free_s = 1.0; // look again within a second, whatever the bounds say
    for (uint32_t j : near_arms_[i]) free_s = std::min(free_s, meet_arm(i, j, angles, mine, push, touched));
    for (uint32_t k : near_obstacles_[i])
        free_s = std::min(free_s, meet_obstacle(i, k, angles[i], mine, push, touched));
    next_look_[i] = tick + static_cast<uint64_t>(free_s / tick_s);
    return push;
}

} // namespace fl::twin
