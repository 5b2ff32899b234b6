#include "cast.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

namespace fl::planning {
namespace {

constexpr double degree = std::numbers::pi / 180.0;
constexpr int finest = 4; // grids up to four times finer are tried for who cannot pass a fiducial

double far_mm(const Bodies &b) { return std::max(std::abs(b.from_mm), std::abs(b.to_mm)); }

} // namespace

Cast::Cast(const Bodies &bodies, const Task &task, const Settings &settings, const Clock &clock)
    : bodies_(bodies), task_(task), settings_(settings), clock_(clock),
      need_mm_(2.0 * bodies.radius_mm + settings.clearance_mm), parts_(bodies.arms.size()) {
    for (int i = 0; i < size(); ++i) {
        const Angles from = start(i), to = task.goal[static_cast<size_t>(i)];
        part(i).goal = to;
        part(i).stuck = task.fixed[static_cast<size_t>(i)] != 0;
        part(i).still =
            std::abs(from.alpha_rad - to.alpha_rad) + std::abs(from.beta_rad - to.beta_rad) < 1e-12;
    }
    find_near();
}

// Whose arms can touch: sorted by x, so that thousands of positioners cost no square.
void Cast::find_near() {
    near_.resize(parts_.size());
    std::vector<int> order(parts_.size());
    for (int i = 0; i < size(); ++i) order[static_cast<size_t>(i)] = i;
    std::sort(order.begin(), order.end(), [&](int i, int j) {
        return std::pair(arm(i).centre_mm.x, i) < std::pair(arm(j).centre_mm.x, j);
    });
    double widest = 0.0;
    for (const Arm &a : bodies_.arms) widest = std::max(widest, std::abs(a.l_alpha_mm) + far_mm(bodies_));
    for (size_t p = 0; p < order.size(); ++p)
        for (size_t q = p + 1; q < order.size(); ++q) {
            const int i = order[p], j = order[q];
            const Vec2 gap = arm(j).centre_mm - arm(i).centre_mm;
            if (gap.x > 2.0 * widest + need_mm_) break;
            const double reach =
                std::abs(arm(i).l_alpha_mm) + std::abs(arm(j).l_alpha_mm) + 2.0 * far_mm(bodies_);
            if (length(gap) >= reach + need_mm_) continue;
            near_[static_cast<size_t>(i)].push_back(j);
            near_[static_cast<size_t>(j)].push_back(i);
        }
    for (auto &list : near_) std::sort(list.begin(), list.end());
}

Piece Cast::leg(int i, Angles goal, bool stands) const {
    return approach_leg(arm(i), bodies_.from_mm, bodies_.to_mm, goal, stands ? 0.0 : approach(i));
}

// What stands still in the way of a leg: a positioner, or -1 for a fiducial or guide camera.
std::optional<int> Cast::blocked_by(int i, const Piece &leg) const {
    for (const Capsule &o : bodies_.obstacles)
        if (!stay_apart(leg, standing(o.line), bodies_.radius_mm + o.radius_mm + settings_.clearance_mm))
            return -1;
    for (int j : near(i))
        if (part(j).stuck && !stay_apart(leg, this->leg(j, start(j), true), need_mm_)) return j;
    return std::nullopt;
}

// A positioner that touches something before it moves stays where it is: nothing can be promised for it.
void Cast::freeze_tangled() {
    for (int i = 0; i < size(); ++i) {
        if (part(i).stuck) continue;
        const Piece here = leg(i, start(i), true);
        std::optional<int> other = blocked_by(i, here);
        for (int j : near(i))
            if (!other && !stay_apart(here, leg(j, start(j), true), need_mm_)) other = j;
        if (!other) continue;
        refused_.push_back({i, Refusal::start_blocked, *other});
    }
    for (const Refused &r : refused_) freeze(r.robot);
}

void Cast::freeze(int i) {
    part(i).stuck = part(i).still = part(i).settled = true;
    part(i).gone = false;
    part(i).goal = start(i);
    for (int j : near(i)) part(j).settled = part(j).stuck; // to be looked at again
}

bool Cast::inside_travel(int i, Angles goal) const {
    const Limits &t = task_.travel;
    const double high = approach(i);
    return goal.alpha_rad >= t.alpha_min_rad && goal.beta_rad >= t.beta_min_rad &&
           goal.alpha_rad + high <= t.alpha_max_rad && goal.beta_rad + high <= t.beta_max_rad;
}

Robot Cast::make_robot(int i) const {
    const Part &p = part(i);
    const Limits &t = task_.travel;
    const double step = clock_.grid_rad / p.finer, high = approach(i);
    AxisGrid alpha(start(i).alpha_rad, p.goal.alpha_rad + high, step, t.alpha_min_rad, t.alpha_max_rad,
                   arm(i).alpha_off_rad);
    AxisGrid beta(start(i).beta_rad, p.goal.beta_rad + high, step, t.beta_min_rad, t.beta_max_rad,
                  arm(i).beta_off_rad);
    Robot robot(arm(i), bodies_.from_mm, bodies_.to_mm, std::move(alpha), std::move(beta), step);
    for (const Capsule &o : bodies_.obstacles)
        robot.add_obstacle(o.line, bodies_.radius_mm + o.radius_mm + settings_.clearance_mm);
    for (int j : near(i))
        if (part(j).stuck) robot.add_obstacle(leg(j, start(j), true).at[0], need_mm_);
    return robot;
}

bool Cast::find_way_alone(int i) {
    for (part(i).finer = 1; part(i).finer <= finest; part(i).finer *= 2) {
        part(i).steps_alone = make_robot(i).steps_alone();
        if (part(i).steps_alone >= 0) return true;
    }
    return false;
}

// Whether the goal stands as far as everything that does not move is concerned.
bool Cast::settle_alone(int i) {
    Part &p = part(i);
    p.settled = true;
    if (p.still) {
        // it may be asked to step aside and come back, if it can
        if (!inside_travel(i, p.goal) || blocked_by(i, leg(i, p.goal, false)) || !find_way_alone(i))
            freeze(i);
        return true;
    }
    if (!inside_travel(i, p.goal)) return send_to_safe_place(i, Refusal::goal_beyond_travel, -1);
    if (const auto other = blocked_by(i, leg(i, p.goal, false)))
        return send_to_safe_place(i, Refusal::goal_blocked, *other);
    return find_way_alone(i) || send_to_safe_place(i, Refusal::no_way_alone, -1);
}

bool Cast::legs_meet(int i, int j, bool i_stands, bool j_stands) const {
    return !stay_apart(leg(i, part(i).goal, i_stands), leg(j, part(j).goal, j_stands), need_mm_);
}

bool Cast::legs_meet(int i, int j) const {
    return !part(i).stuck && !part(j).stuck && !part(i).gone && !part(j).gone &&
           legs_meet(i, j, false, false);
}

// Somebody who stands at its goal in the way of another's approach must make the approach with it.
void Cast::wake_still(int i, int j) {
    if (!part(i).still && !part(j).still) return;
    if (part(i).stuck || part(j).stuck) return;
    if (legs_meet(i, j, part(i).still, false) || legs_meet(i, j, false, part(j).still))
        part(i).still = part(j).still = false;
}

// Of two goals that cannot both be had, the positioner with more such quarrels gives up its own. True if all
// goals go together.
bool Cast::settle_pairs() {
    std::vector<std::vector<int>> quarrels(parts_.size());
    for (int i = 0; i < size(); ++i)
        for (int j : near(i))
            if (legs_meet(i, j)) quarrels[static_cast<size_t>(i)].push_back(j);
    const auto worst = std::max_element(quarrels.begin(), quarrels.end(),
                                        [](const auto &p, const auto &q) { return p.size() < q.size(); });
    if (worst == quarrels.end() || worst->empty()) return true;
    send_to_safe_place(static_cast<int>(worst - quarrels.begin()), Refusal::goal_taken, worst->front());
    return false;
}

void Cast::settle() {
    freeze_tangled();
    bool again = true;
    while (again) {
        again = false;
        for (int i = 0; i < size(); ++i)
            if (!part(i).stuck && !part(i).settled) {
                settle_alone(i);
                again = true;
            }
        if (!again) again = !settle_pairs();
    }
    for (int i = 0; i < size(); ++i)
        for (int j : near(i)) wake_still(i, j);
}

bool Cast::safe(int i, Angles place, bool stands) const {
    if (!stands && !inside_travel(i, place)) return false;
    const Piece down = leg(i, place, false), rest = leg(i, place, true);
    if (blocked_by(i, stands ? rest : down)) return false;
    for (int j : near(i)) {
        if (part(j).stuck || part(j).gone) continue;
        const Piece theirs = leg(j, part(j).goal, false);
        if (!stay_apart(stands ? rest : down, theirs, need_mm_)) return false;
    }
    return true;
}

bool Cast::try_place(int i, Angles place, bool stands) {
    if (!safe(i, place, stands)) return false;
    Part &p = part(i);
    p.goal = place;
    p.still = stands;
    if (!stands && !find_way_alone(i)) return false;
    if (stands) {
        // nobody shall ask it to move unless its approach is clear as well
        if (!safe(i, place, false) || !find_way_alone(i)) freeze(i);
    }
    p.settled = true;
    p.gone = false;
    return true;
}

// Folded arms, nearest to the start first.
std::vector<Angles> Cast::places(int i) const {
    const Limits &t = task_.travel;
    std::vector<std::tuple<double, double, double>> order;
    for (double beta : {170.0, 175.0, 165.0, 160.0, 150.0, 140.0})
        for (double alpha = 0.0; alpha <= 360.0; alpha += 10.0)
            order.emplace_back(std::abs(alpha * degree - start(i).alpha_rad), beta * degree, alpha * degree);
    std::sort(order.begin(), order.end());
    std::vector<Angles> out;
    for (const auto &[way, beta, alpha] : order) out.push_back({std::max(alpha, t.alpha_min_rad), beta});
    return out;
}

bool Cast::send_to_safe_place(int i, Refusal why, int other) {
    refused_.push_back({i, why, other});
    part(i).gone = true;
    if (try_place(i, start(i), true)) return true;
    for (const Angles place : places(i))
        if (try_place(i, place, false)) return true;
    freeze(i);
    return false;
}

} // namespace fl::planning
