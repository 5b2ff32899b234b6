#include "goals/goal_feasibility.hpp"

#include "guide/joint_reach.hpp"
#include "motion/near_pairs.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

namespace fl::planning {
namespace {

constexpr double degree = std::numbers::pi / 180.0;
constexpr double free_steps = 1.0; // of the grid, around start and goal, in which nothing is kept in hand
constexpr int finest = 4;          // grids up to four times finer are tried where a body cannot be passed
// Where two interlock their grids become finer around start and goal: there arms are nearest to each other.
// That makes the way hardly longer, as an axis goes one line in a step, however near that is. Where it does
// not help they become finer everywhere.
constexpr int fineness_at_ends = 4;
constexpr double fine_steps = 2.6; // of the grid, around start and goal, in which it is finer

// Of grids on which it is looked whether two lock each other; the first one that does not take too much room.
constexpr int fineness_of_a_proof[] = {8, 4};

// Of one in a pocket that makes way with other approaches: places, and positioners that change theirs.
constexpr int most_places_tried = 40, most_that_make_way = 4;

constexpr double beside_rad = 0.5; // alpha and beta in sum

bool beside(Angles p, Angles q) {
    return std::abs(p.alpha_rad - q.alpha_rad) + std::abs(p.beta_rad - q.beta_rad) <= beside_rad;
}

int number_or_none(std::optional<PositionerIndex> i) { return i ? i->value() : -1; }

} // namespace

GoalFeasibility::GoalFeasibility(const Bodies &bodies, const Task &task, const Settings &settings,
                                 const Clock &clock)
    : bodies_(bodies), arms_(bodies), task_(task), settings_(settings), clock_(clock),
      need_mm_(2.0 * arms_.radius_mm() + settings.clearance_mm), goals_(static_cast<int>(bodies.arms.size())),
      grids_(goals_.size()) {
    for (const PositionerIndex i : places()) {
        const Angles from = start(i), to = row(task.goal, i);
        set_goal(i, to, usual(i));
        goals_[i].stuck = row(task.fixed, i) != 0;
        if (goals_[i].stuck) goals_[i].legs = Legs(body(i), from);
        goals_[i].still =
            std::abs(from.alpha_rad - to.alpha_rad) + std::abs(from.beta_rad - to.beta_rad) < 1e-12;
    }
    find_near();
}

// Pairs of arms that can touch.
void GoalFeasibility::find_near() {
    near_.resize(goals_.size());
    for (const NearPair &pair : near_pairs(arms_.reaches(), need_mm_)) {
        near_[PositionerIndex(pair.first)].push_back(PositionerIndex(pair.second));
        near_[PositionerIndex(pair.second)].push_back(PositionerIndex(pair.first));
    }
    for (auto &list : near_) std::sort(list.begin(), list.end());
}

// Also of one that is not to move: it may be asked to step aside, and comes back so.
void GoalFeasibility::set_goal(PositionerIndex i, Angles angles, const Descent &descent) {
    goals_[i].angles = angles;
    goals_[i].descent = descent;
    goals_[i].legs = Legs(body(i), angles, descent);
}

GoalFeasibility::Blocked GoalFeasibility::blocked(PositionerIndex i, const SweptArm &leg) const {
    for (int k = 0; k < static_cast<int>(bodies_.obstacles.size()); ++k) {
        const Capsule &o = bodies_.obstacles[static_cast<size_t>(k)];
        if (o.owner != i.value() && !stay_apart(leg, resting_obstacle(o), obstacle_need_mm(o)))
            return {true, std::nullopt, k};
    }
    for (const PositionerIndex j : near(i))
        if (goals_[j].stuck && !stay_apart(leg, goals_[j].legs.rest(), need_mm_)) return {true, j};
    return {};
}

GoalFeasibility::Blocked GoalFeasibility::blocked(PositionerIndex i, const Legs &legs) const {
    Blocked found = blocked(i, legs.rest());
    for (int turn = 0; turn < legs.turns() && !found.any; ++turn) found = blocked(i, legs.at(turn));
    return found;
}

// A positioner that touches something before it moves stays where it is: nothing can be promised for it.
void GoalFeasibility::freeze_tangled() {
    List<PositionerIndex> tangled;
    for (const PositionerIndex i : places()) {
        if (goals_[i].stuck) continue;
        const Legs here(body(i), start(i));
        Blocked found = blocked(i, here);
        for (const PositionerIndex j : near(i))
            if (!found.any && !stay_apart(here, Legs(body(j), start(j)), need_mm_)) found = {true, j};
        if (!found.any) continue;
        tangled.push_back(i);
        refuse(i, Refusal::start_blocked, found);
    }
    for (const PositionerIndex i : tangled) freeze(i);
}

bool GoalFeasibility::is_refused(PositionerIndex i) const {
    return std::any_of(refused_.begin(), refused_.end(),
                       [&](const Refused &r) { return r.robot == i.value(); });
}

// Only the first reason counts: the others follow from it.
void GoalFeasibility::refuse(PositionerIndex i, Refusal why, const Blocked &by) {
    if (!is_refused(i)) refused_.push_back({i.value(), why, number_or_none(by.by), by.obstacle});
}

void GoalFeasibility::freeze(PositionerIndex i) {
    Goal &goal = goals_[i];
    goal.stuck = goal.still = goal.settled = true;
    goal.gone = false;
    goal.angles = start(i);
    goal.legs = Legs(body(i), start(i));
    for (const PositionerIndex j : near(i)) goals_[j].settled = goals_[j].stuck; // to be looked at again
}

bool GoalFeasibility::inside_travel(PositionerIndex i, Angles place) const {
    const Limits &t = travel(i);
    return place.alpha_rad >= t.alpha_min_rad && place.beta_rad >= t.beta_min_rad &&
           place.alpha_rad <= t.alpha_max_rad && place.beta_rad <= t.beta_max_rad;
}

bool GoalFeasibility::inside_travel(PositionerIndex i, Angles place, const Descent &descent) const {
    return inside_travel(i, place) && inside_travel(i, {place.alpha_rad + descent.alpha.height_rad,
                                                        place.beta_rad + descent.beta.height_rad});
}

const AxisGrid &GoalFeasibility::grid(PositionerIndex i, double Angles::*axis, double step_rad) {
    const Limits &t = travel(i);
    const bool alpha = axis == &Angles::alpha_rad;
    const GridSpan span{start(i).*axis,
                        goals_[i].angles.*axis + descent(i).above(0).*axis,
                        alpha ? t.alpha_min_rad : t.beta_min_rad,
                        alpha ? t.alpha_max_rad : t.beta_max_rad,
                        alpha ? arm(i).alpha_off_rad : arm(i).beta_off_rad,
                        goals_[i].finer_at_ends,
                        fine_steps * clock_.grid_rad(pace(i))};
    KnownGrid &known = alpha ? grids_[i].alpha : grids_[i].beta;
    const FineLines &fine = alpha ? goals_[i].fine.alpha : goals_[i].fine.beta;
    if (!(known.span == span) || known.step_rad != step_rad || !(known.fine == fine))
        known = {span, step_rad, fine, AxisGrid(span, step_rad, fine)};
    return known.grid;
}

Robot GoalFeasibility::make_robot(PositionerIndex i) {
    const double step = step_rad(i);
    Robot robot(body(i), grid(i, &Angles::alpha_rad, step), grid(i, &Angles::beta_rad, step), step);
    if (goals_[i].in_hand) robot.keep_in_hand(settings_.in_hand_mm, free_steps * clock_.grid_rad(pace(i)));
    if (settings_.late_s > 0.0) robot.set_legs(goals_[i].legs.all());
    for (const Capsule &o : bodies_.obstacles)
        if (o.owner != i.value()) robot.add_obstacle(resting_obstacle(o), obstacle_need_mm(o));
    for (const PositionerIndex j : near(i))
        if (goals_[j].stuck) robot.add_obstacle(goals_[j].legs.rest(), need_mm_);
    return robot;
}

// On a grid that is finer everywhere by a factor, with nothing in hand.
Robot GoalFeasibility::without_hand(PositionerIndex i, int finer) {
    const Goal before = goals_[i];
    goals_[i].finer = finer;
    goals_[i].fine = {};
    goals_[i].finer_at_ends = 1;
    goals_[i].in_hand = false;
    Robot robot = make_robot(i);
    goals_[i] = before;
    return robot;
}

bool GoalFeasibility::lock_each_other(PositionerIndex i, PositionerIndex j) {
    for (const int finer : fineness_of_a_proof) {
        const Robot first = without_hand(i, finer), second = without_hand(j, finer);
        const std::int64_t of_first = JointReach::words(first, second),
                           of_second = JointReach::words(second, first);
        if (std::min(of_first, of_second) > JointReach::most_words) continue;
        return of_first < of_second ? JointReach().none(first, second, need_mm_)
                                    : JointReach().none(second, first, need_mm_);
    }
    return false;
}

bool GoalFeasibility::find_path_alone(PositionerIndex i) {
    Goal &goal = goals_[i];
    goal.finer_at_ends = 1;
    goal.fine = {};
    goal.hastened = false;
    for (goal.finer = 1; goal.finer <= finest; goal.finer *= 2) {
        for (const bool in_hand : {true, false}) {
            if (in_hand && goal.tight) continue;
            goal.in_hand = in_hand;
            goal.steps_alone = make_robot(i).steps_alone();
            if (goal.steps_alone >= 0) return true;
            if (settings_.in_hand_mm == 0.0) break;
        }
    }
    return false;
}

// Whether the goal can be held as far as everything that does not move is concerned.
bool GoalFeasibility::settle_alone(PositionerIndex i) {
    goals_[i].settled = true;
    if (find_descent(i)) return true;
    if (!goals_[i].still) return give_up(i);
    freeze(i); // otherwise it could be asked to step aside and come back
    return true;
}

// Of a step on the grid: so much nearer to another than it is may an arm seem while it comes to rest.
double GoalFeasibility::bulge_mm(PositionerIndex i) const { return step_bulge_mm(body(i), step_rad(i)); }

// Whether two stay apart on their legs, and the places where these begin can be come to one after the other.
bool GoalFeasibility::apart(PositionerIndex i, const Legs &mine, PositionerIndex j,
                            const Legs &theirs) const {
    if (j < i) return apart(j, theirs, i, mine); // the last bit of a distance depends on the order
    if (!stay_apart(mine, theirs, need_mm_)) return false;
    if (goals_[i].still || goals_[j].still) return true;
    const double room_mm = std::min(bulge_mm(i), bulge_mm(j));
    return apart_at_first(mine.at(0), theirs.at(0), need_mm_ + room_mm);
}

bool GoalFeasibility::legs_touch(PositionerIndex i, PositionerIndex j) const {
    return !away(i) && !away(j) && !apart(i, goals_[i].legs, j, goals_[j].legs);
}

// One that rests at its goal in the way of another's approach must make the approach with it.
void GoalFeasibility::wake_still(PositionerIndex i, PositionerIndex j) {
    if (!goals_[i].still && !goals_[j].still) return;
    if (goals_[i].stuck || goals_[j].stuck) return;
    const auto touches_resting = [&](PositionerIndex resting, PositionerIndex other) {
        const Legs rest(body(resting), goals_[resting].angles);
        return goals_[resting].still && !stay_apart(rest, goals_[other].legs, need_mm_);
    };
    if (touches_resting(i, j) || touches_resting(j, i)) goals_[i].still = goals_[j].still = false;
}

// Pairs that touch while they come to their goals take other ways down. Where that does not help, the
// positioner with more such rivals gives up its goal. True if all goals go together.
bool GoalFeasibility::settle_pairs() {
    List<List<PositionerIndex>, PositionerIndex> rivals(goals_.size());
    for (const PositionerIndex i : places())
        for (const PositionerIndex j : near(i))
            if (legs_touch(i, j)) rivals[i].push_back(j);
    const auto worst = std::max_element(rivals.begin(), rivals.end(),
                                        [](const auto &p, const auto &q) { return p.size() < q.size(); });
    if (worst == rivals.end() || worst->empty()) return true;
    // each time fewer pairs touch, so that this is no limit that is met; but settling has to end
    if (rearranged_ < goals_.size() && rearrange_some(rivals)) {
        ++rearranged_;
        return false;
    }
    const PositionerIndex loser(static_cast<int>(worst - rivals.begin()));
    move_away(loser, meeting(loser, worst->front()), {true, worst->front()});
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
    relax();
    for (const PositionerIndex i : places())
        for (const PositionerIndex j : near(i)) wake_still(i, j);
}

bool GoalFeasibility::safe(PositionerIndex i, const Legs &legs) const {
    if (blocked(i, legs).any) return false;
    return std::all_of(near(i).begin(), near(i).end(), [&](PositionerIndex j) {
        return away(j) || stay_apart(legs, goals_[j].legs, need_mm_);
    });
}

bool GoalFeasibility::try_place(PositionerIndex i, Angles place, bool rests) {
    const Legs legs(body(i), place, usual(i));
    const bool comes = inside_travel(i, place, usual(i)) && safe(i, legs);
    if (rests ? !safe(i, Legs(body(i), place)) : !comes) return false;
    Goal &goal = goals_[i];
    set_goal(i, place, usual(i));
    goal.still = rests;
    if (!rests && !find_path_alone(i)) return false;
    if (rests) {
        // it shall not be asked to move unless its approach is clear as well
        if (!comes || !find_path_alone(i)) freeze(i);
    }
    if (!goal.stuck) go_finely_in_a_pocket(i);
    goal.settled = true;
    goal.gone = false;
    return true;
}

// One that can only be beside its start has no long way to go: on the finest grid it loses no time, and finds
// places in which it is less in the way. On a wide one it has a few places.
void GoalFeasibility::go_finely_in_a_pocket(PositionerIndex i) {
    const List<Angles> places = reachable_places(i);
    if (!std::all_of(places.begin(), places.end(), [&](Angles place) { return beside(place, start(i)); }))
        return;
    Goal &goal = goals_[i];
    const Goal before = goal;
    goal.finer = finest;
    goal.hastened = true;
    goal.steps_alone = make_robot(i).steps_alone();
    if (goal.steps_alone < 0) goal = before;
}

// Folded arms, nearest to the start first; with the other elbow where the room of beta is there.
List<Angles> GoalFeasibility::folded_places(PositionerIndex i) const {
    const Limits &t = travel(i);
    const double elbow = t.beta_max_rad < 90.0 * degree ? -1.0 : 1.0;
    List<std::tuple<double, double, double>> order;
    for (double beta : {170.0, 175.0, 165.0, 160.0, 150.0, 140.0})
        for (double turn = 0.0; turn <= 360.0; turn += 10.0) {
            const double alpha = turn * degree > t.alpha_max_rad ? turn - 360.0 : turn;
            order.emplace_back(std::abs(alpha * degree - start(i).alpha_rad), elbow * beta * degree,
                               alpha * degree);
        }
    std::sort(order.begin(), order.end());
    List<Angles> out;
    for (const auto &[way, beta, alpha] : order) out.push_back({std::max(alpha, t.alpha_min_rad), beta});
    return out;
}

// Where it can come to past what does not move, the nearest first: one in a pocket stays in it, but may make
// room there for others.
List<Angles> GoalFeasibility::reachable_places(PositionerIndex i) {
    Robot robot = make_robot(i);
    const Angles above = usual(i).above(0);
    List<Angles> out;
    for (const Cell c : robot.reachable())
        out.push_back(
            {robot.alpha().angle(c.alpha) - above.alpha_rad, robot.beta().angle(c.beta) - above.beta_rad});
    return out;
}

// Where it is in each step if nothing is in its way: both axes go at once until the nearer one is there.
List<SweptArm> GoalFeasibility::straight_way(PositionerIndex i) const {
    const Angles from = start(i), to = goals_[i].angles;
    const double alpha = to.alpha_rad - from.alpha_rad, beta = to.beta_rad - from.beta_rad;
    const double step = step_rad(i);
    const auto gone = [step](double way, int steps) { return std::clamp(way, -step * steps, step * steps); };
    List<SweptArm> out;
    for (int k = 0; (k - 1) * step < std::max(std::abs(alpha), std::abs(beta)); ++k) {
        const Angles here{from.alpha_rad + gone(alpha, k), from.beta_rad + gone(beta, k)};
        out.push_back(Legs(body(i), here).rest());
    }
    return out;
}

// Those that are not beside its start, and in which it is in the way of no more others than there; of fewest
// first.
List<Angles> GoalFeasibility::elsewhere(PositionerIndex i, const List<Angles> &places) const {
    List<List<SweptArm>> ways;
    for (const PositionerIndex j : near(i))
        if (!away(j) && !goals_[j].still) ways.push_back(straight_way(j));
    const auto met = [&](Angles place) {
        const SweptArm here = Legs(body(i), place).rest();
        return std::count_if(ways.begin(), ways.end(), [&](const List<SweptArm> &way) {
            return !std::all_of(way.begin(), way.end(),
                                [&](const SweptArm &there) { return stay_apart(here, there, need_mm_); });
        });
    };
    const auto most = met(start(i));
    List<std::pair<std::int64_t, int>> order;
    for (const int k : places.places())
        if (!beside(places[k], start(i)))
            if (const auto these = met(places[k]); these <= most) order.emplace_back(these, k);
    std::sort(order.begin(), order.end());
    List<Angles> out;
    for (const auto &[these, k] : order) out.push_back(places[k]);
    return out;
}

bool GoalFeasibility::go_elsewhere(PositionerIndex i) {
    const Angles at = goals_[i].angles;
    if (!is_refused(i) || away(i) || at.alpha_rad != start(i).alpha_rad || at.beta_rad != start(i).beta_rad)
        return false;
    const Goal before = goals_[i];
    List<Angles> places = folded_places(i);
    const List<Angles> others = reachable_places(i);
    places.insert(places.end(), others.begin(), others.end());
    goals_[i].gone = true;
    for (const Angles place : elsewhere(i, places))
        if (try_place(i, place, false)) return true;
    goals_[i] = before;
    return false;
}

// One that cannot get out of the way of all others, in a pocket, takes the place there in which fewest of
// them lose their goals, if that are fewer than where it stands. They must not have lost one before: so this
// ends.
bool GoalFeasibility::make_room(PositionerIndex i) {
    const Legs here(body(i), start(i));
    const auto lost = std::count_if(near(i).begin(), near(i).end(), [&](PositionerIndex j) {
        return !away(j) && !stay_apart(here, Legs(body(j), goals_[j].angles), need_mm_);
    });
    if (lost < 2) return false;
    Angles place;
    List<PositionerIndex> losers;
    for (const Angles other : reachable_places(i)) {
        const Legs legs(body(i), other, usual(i));
        if (!inside_travel(i, other, usual(i)) || blocked(i, legs).any) continue;
        const List<PositionerIndex> met = blockers(i, legs, {});
        if (met.empty() || met.size() >= (losers.empty() ? lost : losers.size()))
            continue; // empty: no way there
        if (std::any_of(met.begin(), met.end(), [&](PositionerIndex j) { return is_refused(j); })) continue;
        place = other;
        losers = met;
    }
    if (losers.empty()) return false;
    set_goal(i, place, usual(i));
    if (!find_path_alone(i)) return false;
    goals_[i].settled = true;
    goals_[i].still = goals_[i].gone = false;
    for (const PositionerIndex j : losers) move_away(j, meeting(j, i), {true, i});
    return true;
}

// One in a pocket, where it touches no goal of another though its approach, or theirs, touches: with other
// approaches of all of them. Of places that it can come to, the nearest are tried.
bool GoalFeasibility::make_way(PositionerIndex i) {
    int tried = 0;
    for (const Angles place : reachable_places(i)) {
        if (tried == most_places_tried) break;
        const Legs rest(body(i), place);
        const bool clear = std::all_of(near(i).begin(), near(i).end(), [&](PositionerIndex j) {
            return away(j) || stay_apart(rest, Legs(body(j), goals_[j].angles), need_mm_);
        });
        if (!clear || !inside_travel(i, place, lowest(i)) || blocked(i, Legs(body(i), place, lowest(i))).any)
            continue;
        ++tried;
        set_goal(i, place, usual(i));
        goals_[i].gone = goals_[i].still = false;
        List<PositionerIndex> group{i};
        for (const PositionerIndex j : blockers(i, goals_[i].legs, {})) group.push_back(j);
        if (group.size() <= most_that_make_way && rearrange(group)) {
            goals_[i].settled = true;
            return true;
        }
        goals_[i].gone = true;
    }
    return false;
}

// Gives up a goal; another place that cannot be held is replaced in the same way.
bool GoalFeasibility::move_away(PositionerIndex i, Refusal why, const Blocked &by) {
    refuse(i, why, by);
    goals_[i].gone = true;
    if (try_place(i, start(i), true)) return true;
    for (const Angles place : folded_places(i))
        if (try_place(i, place, false)) return true;
    for (const Angles place : reachable_places(i))
        if (try_place(i, place, false)) return true;
    if (make_way(i) || make_room(i)) return true;
    freeze(i);
    return false;
}

bool GoalFeasibility::send_to_safe_place(PositionerIndex i, Refusal why,
                                         std::optional<PositionerIndex> other) {
    if (!is_refused(i)) return move_away(i, why, {true, other});
    freeze(i);
    return false;
}

void GoalFeasibility::give_up_one(PositionerIndex first, PositionerIndex second, Refusal why) {
    const State before = state();
    if (send_to_safe_place(first, why, second)) return;
    const State of_first = state();
    go_back_to(before);
    if (send_to_safe_place(second, why, first)) return;
    go_back_to(of_first);
}

void GoalFeasibility::make_finer(Goal &goal) {
    if (goal.finer == 1 && goal.finer_at_ends == 1) {
        goal.finer_at_ends = fineness_at_ends;
    } else {
        // where it had to be finer to pass at all, it is at least as fine everywhere
        goal.finer = std::max({2 * goal.finer, goal.fine.alpha.parts, goal.fine.beta.parts});
        goal.finer_at_ends = 1;
        goal.fine = {};
    }
    goal.hastened = true;
}

bool GoalFeasibility::refine(PositionerIndex i) {
    Goal &goal = goals_[i];
    const Goal before = goal;
    // where one axis has finer lines than the other they no longer go one line each in the same step: what
    // was a way past the bodies at rest need not be one
    while (goal.finer < finest) {
        make_finer(goal);
        goal.steps_alone = make_robot(i).steps_alone();
        if (goal.steps_alone >= 0) return true;
    }
    goal = before;
    return false;
}

bool GoalFeasibility::spend_one(PositionerIndex i) {
    Goal &goal = goals_[i];
    if (settings_.in_hand_mm == 0.0 || away(i) || !goal.in_hand) return false;
    goal.tight = true;
    goal.in_hand = false;
    return true;
}

bool GoalFeasibility::spend(const List<PositionerIndex> &tangled) {
    bool any = false;
    for (const PositionerIndex i : tangled) {
        any |= spend_one(i);
        for (const PositionerIndex j : near(i)) any |= spend_one(j);
    }
    return any;
}

void GoalFeasibility::has_no_way(PositionerIndex i) {
    if (!spend_one(i)) send_to_safe_place(i, Refusal::no_way_alone, {});
}

} // namespace fl::planning
