#include "goals/goal_feasibility.hpp"

#include "motion/near_pairs.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

namespace fl::planning {
namespace {

constexpr double degree = std::numbers::pi / 180.0;
constexpr int finest = 4; // grids up to four times finer are tried where a fiducial cannot be passed

int number_or_none(std::optional<PositionerIndex> i) { return i ? i->value() : -1; }

} // namespace

GoalFeasibility::GoalFeasibility(const Bodies &bodies, const Task &task, const Settings &settings,
                                 const Clock &clock)
    : bodies_(bodies), task_(task), settings_(settings), clock_(clock),
      need_mm_(2.0 * bodies.radius_mm + settings.clearance_mm), goals_(static_cast<int>(bodies.arms.size())) {
    for (const PositionerIndex i : places()) {
        const Angles from = start(i), to = row(task.goal, i);
        goals_[i].angles = to;
        goals_[i].stuck = row(task.fixed, i) != 0;
        goals_[i].still =
            std::abs(from.alpha_rad - to.alpha_rad) + std::abs(from.beta_rad - to.beta_rad) < 1e-12;
    }
    find_near();
}

// Pairs of arms that can touch.
void GoalFeasibility::find_near() {
    near_.resize(goals_.size());
    List<Vec2> centres;
    double widest = 0.0;
    for (const PositionerIndex i : places()) {
        centres.push_back(arm(i).centre_mm);
        widest = std::max(widest, 2.0 * reach_mm(i) + need_mm_);
    }
    for (const NearPair &pair : near_pairs(centres, widest)) {
        const PositionerIndex i(pair.first), j(pair.second);
        if (pair.gap_mm >= reach_mm(i) + reach_mm(j) + need_mm_) continue;
        near_[i].push_back(j);
        near_[j].push_back(i);
    }
    for (auto &list : near_) std::sort(list.begin(), list.end());
}

SweptArm GoalFeasibility::leg(PositionerIndex i, Angles goal, bool rests) const {
    return approach_leg(arm_body(bodies_, arm(i)), goal, rests ? 0.0 : approach(i));
}

GoalFeasibility::Blocked GoalFeasibility::blocked(PositionerIndex i, const SweptArm &leg) const {
    for (const Capsule &o : bodies_.obstacles)
        if (!stay_apart(leg, resting_arm(o.line), bodies_.radius_mm + o.radius_mm + settings_.clearance_mm))
            return {true, std::nullopt};
    for (const PositionerIndex j : near(i))
        if (goals_[j].stuck && !stay_apart(leg, this->leg(j, start(j), true), need_mm_)) return {true, j};
    return {};
}

// A positioner that touches something before it moves stays where it is: nothing can be promised for it.
void GoalFeasibility::freeze_tangled() {
    for (const PositionerIndex i : places()) {
        if (goals_[i].stuck) continue;
        const SweptArm here = leg(i, start(i), true);
        Blocked found = blocked(i, here);
        for (const PositionerIndex j : near(i))
            if (!found.any && !stay_apart(here, leg(j, start(j), true), need_mm_)) found = {true, j};
        if (found.any) refused_.push_back({i.value(), Refusal::start_blocked, number_or_none(found.by)});
    }
    for (const Refused &r : refused_) freeze(PositionerIndex(r.robot));
}

void GoalFeasibility::freeze(PositionerIndex i) {
    Goal &goal = goals_[i];
    goal.stuck = goal.still = goal.settled = true;
    goal.gone = false;
    goal.angles = start(i);
    for (const PositionerIndex j : near(i)) goals_[j].settled = goals_[j].stuck; // to be looked at again
}

bool GoalFeasibility::inside_travel(PositionerIndex i, Angles goal) const {
    const Limits &t = task_.travel;
    const double high = approach(i);
    return goal.alpha_rad >= t.alpha_min_rad && goal.beta_rad >= t.beta_min_rad &&
           goal.alpha_rad + high <= t.alpha_max_rad && goal.beta_rad + high <= t.beta_max_rad;
}

AxisGrid GoalFeasibility::grid(PositionerIndex i, double Angles::*axis, double step_rad) const {
    const Limits &t = task_.travel;
    const bool alpha = axis == &Angles::alpha_rad;
    return AxisGrid({start(i).*axis, goals_[i].angles.*axis + approach(i),
                     alpha ? t.alpha_min_rad : t.beta_min_rad, alpha ? t.alpha_max_rad : t.beta_max_rad,
                     alpha ? arm(i).alpha_off_rad : arm(i).beta_off_rad},
                    step_rad);
}

Robot GoalFeasibility::make_robot(PositionerIndex i) const {
    const double step = clock_.grid_rad / goals_[i].finer;
    Robot robot(arm_body(bodies_, arm(i)), grid(i, &Angles::alpha_rad, step),
                grid(i, &Angles::beta_rad, step), step);
    for (const Capsule &o : bodies_.obstacles)
        robot.add_obstacle(o.line, bodies_.radius_mm + o.radius_mm + settings_.clearance_mm);
    for (const PositionerIndex j : near(i))
        if (goals_[j].stuck) robot.add_obstacle(leg(j, start(j), true).at[0], need_mm_);
    return robot;
}

bool GoalFeasibility::find_path_alone(PositionerIndex i) {
    Goal &goal = goals_[i];
    for (goal.finer = 1; goal.finer <= finest; goal.finer *= 2) {
        goal.steps_alone = make_robot(i).steps_alone();
        if (goal.steps_alone >= 0) return true;
    }
    return false;
}

// Whether the goal can be held as far as everything that does not move is concerned.
bool GoalFeasibility::settle_alone(PositionerIndex i) {
    Goal &goal = goals_[i];
    goal.settled = true;
    const bool inside = inside_travel(i, goal.angles);
    const Blocked found = inside ? blocked(i, leg(i, goal.angles, false)) : Blocked{};
    if (goal.still) {
        // it may be asked to step aside and come back, if it can
        if (!inside || found.any || !find_path_alone(i)) freeze(i);
        return true;
    }
    if (!inside) return send_to_safe_place(i, Refusal::goal_beyond_travel, {});
    if (found.any) return send_to_safe_place(i, Refusal::goal_blocked, found.by);
    return find_path_alone(i) || send_to_safe_place(i, Refusal::no_way_alone, {});
}

bool GoalFeasibility::legs_touch(PositionerIndex i, bool i_rests, PositionerIndex j, bool j_rests) const {
    return !stay_apart(leg(i, goals_[i].angles, i_rests), leg(j, goals_[j].angles, j_rests), need_mm_);
}

bool GoalFeasibility::legs_touch(PositionerIndex i, PositionerIndex j) const {
    const auto away = [this](PositionerIndex k) { return goals_[k].stuck || goals_[k].gone; };
    return !away(i) && !away(j) && legs_touch(i, false, j, false);
}

// One that rests at its goal in the way of another's approach must make the approach with it.
void GoalFeasibility::wake_still(PositionerIndex i, PositionerIndex j) {
    if (!goals_[i].still && !goals_[j].still) return;
    if (goals_[i].stuck || goals_[j].stuck) return;
    if (legs_touch(i, goals_[i].still, j, false) || legs_touch(i, false, j, goals_[j].still))
        goals_[i].still = goals_[j].still = false;
}

// Of two goals that cannot both be had, the positioner with more such rivals gives up its own. True if all
// goals go together.
bool GoalFeasibility::settle_pairs() {
    List<List<PositionerIndex>, PositionerIndex> rivals(goals_.size());
    for (const PositionerIndex i : places())
        for (const PositionerIndex j : near(i))
            if (legs_touch(i, j)) rivals[i].push_back(j);
    const auto worst = std::max_element(rivals.begin(), rivals.end(),
                                        [](const auto &p, const auto &q) { return p.size() < q.size(); });
    if (worst == rivals.end() || worst->empty()) return true;
    send_to_safe_place(PositionerIndex(static_cast<int>(worst - rivals.begin())), Refusal::goal_taken,
                       worst->front());
    return false;
}

// True if some goal had not been looked at.
bool GoalFeasibility::settle_each() {
    bool any = false;
    for (const PositionerIndex i : places())
        if (!goals_[i].stuck && !goals_[i].settled) {
            settle_alone(i);
            any = true;
        }
    return any;
}

void GoalFeasibility::settle() {
    freeze_tangled();
    while (settle_each() || !settle_pairs()) {}
    for (const PositionerIndex i : places())
        for (const PositionerIndex j : near(i)) wake_still(i, j);
}

bool GoalFeasibility::safe(PositionerIndex i, Angles place, bool rests) const {
    if (!rests && !inside_travel(i, place)) return false;
    const SweptArm mine = leg(i, place, rests);
    if (blocked(i, mine).any) return false;
    return std::all_of(near(i).begin(), near(i).end(), [&](PositionerIndex j) {
        return goals_[j].stuck || goals_[j].gone ||
               stay_apart(mine, leg(j, goals_[j].angles, false), need_mm_);
    });
}

bool GoalFeasibility::try_place(PositionerIndex i, Angles place, bool rests) {
    if (!safe(i, place, rests)) return false;
    Goal &goal = goals_[i];
    goal.angles = place;
    goal.still = rests;
    if (!rests && !find_path_alone(i)) return false;
    if (rests) {
        // it shall not be asked to move unless its approach is clear as well
        if (!safe(i, place, false) || !find_path_alone(i)) freeze(i);
    }
    goal.settled = true;
    goal.gone = false;
    return true;
}

// Folded arms, nearest to the start first.
List<Angles> GoalFeasibility::folded_places(PositionerIndex i) const {
    const Limits &t = task_.travel;
    List<std::tuple<double, double, double>> order;
    for (double beta : {170.0, 175.0, 165.0, 160.0, 150.0, 140.0})
        for (double alpha = 0.0; alpha <= 360.0; alpha += 10.0)
            order.emplace_back(std::abs(alpha * degree - start(i).alpha_rad), beta * degree, alpha * degree);
    std::sort(order.begin(), order.end());
    List<Angles> out;
    for (const auto &[way, beta, alpha] : order) out.push_back({std::max(alpha, t.alpha_min_rad), beta});
    return out;
}

bool GoalFeasibility::send_to_safe_place(PositionerIndex i, Refusal why,
                                         std::optional<PositionerIndex> other) {
    refused_.push_back({i.value(), why, number_or_none(other)});
    goals_[i].gone = true;
    if (try_place(i, start(i), true)) return true;
    for (const Angles place : folded_places(i))
        if (try_place(i, place, false)) return true;
    freeze(i);
    return false;
}

void GoalFeasibility::has_no_way(PositionerIndex i) {
    const bool again =
        std::any_of(refused_.begin(), refused_.end(), [&](const Refused &r) { return r.robot == i.value(); });
    if (again)
        freeze(i);
    else
        send_to_safe_place(i, Refusal::no_way_alone, {});
}

} // namespace fl::planning
