// Ways down to the goals: of each positioner past what does not move, and of neighbours past each other.
#include "goals/goal_feasibility.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

constexpr int most_tests = 50'000; // of pairs of descents in one group; two positioners have 14641
constexpr int largest_group = 4;   // of positioners that change their descents together

} // namespace

struct GoalFeasibility::Open {
    PositionerIndex robot;
    List<RatedDescent> ways;
    List<Legs> legs; // of each way
};

namespace {

// One descent for each positioner of a group, so that none of them touch: the cheapest together.
template <class Open, class Apart> class Combination {
  public:
    Combination(const List<Open> &open, Apart apart) : open_(open), apart_(apart) {}

    // One way of each; empty: none was found.
    List<int> cheapest() {
        choose(0);
        return best_;
    }

  private:
    bool clear(const Open &next, int way) {
        for (int k = 0; k < chosen_.size(); ++k) {
            ++tests_;
            if (!apart_(open_[k].robot, open_[k].legs[chosen_[k]], next.robot, next.legs[way])) return false;
        }
        return true;
    }

    void choose(int cost) {
        if (chosen_.size() == open_.size()) {
            best_ = chosen_;
            best_cost_ = cost;
            return;
        }
        const Open &next = open_[chosen_.size()];
        for (int way = 0; way < next.ways.size() && tests_ < most_tests; ++way) {
            const int now = cost + next.ways[way].cost;
            if (!best_.empty() && now >= best_cost_) return; // the others cost more still
            if (!clear(next, way)) continue;
            chosen_.push_back(way);
            choose(now);
            chosen_.pop_back();
        }
    }

    const List<Open> &open_;
    Apart apart_;
    int tests_ = 0, best_cost_ = 0;
    List<int> chosen_, best_;
};

} // namespace

Descent GoalFeasibility::coming_from(const std::vector<double> &heights_rad, PositionerIndex i) const {
    const Angles beside = task_.sides.beside(row(heights_rad, i));
    return {{beside.alpha_rad}, {beside.beta_rad}};
}

Descent GoalFeasibility::usual(PositionerIndex i) const { return coming_from(task_.approach_rad, i); }

Descent GoalFeasibility::lowest(PositionerIndex i) const {
    if (task_.least_approach_rad.empty()) return usual(i);
    return coming_from(task_.least_approach_rad, i);
}

List<RatedDescent> GoalFeasibility::descents_of(PositionerIndex i) const {
    const double height = row(task_.approach_rad, i);
    const double least = task_.least_approach_rad.empty() ? height : row(task_.least_approach_rad, i);
    List<RatedDescent> out = descents(
        {height, least, settings_.approach_turns, clock_.highest_hook_rad(pace(i).acceleration_rad_s2)});
    for (RatedDescent &rated : out) {
        rated.descent.alpha.height_rad *= task_.sides.alpha;
        rated.descent.beta.height_rad *= task_.sides.beta;
    }
    return out;
}

void GoalFeasibility::take(PositionerIndex i, const Descent &descent) {
    set_goal(i, goals_[i].angles, descent);
    find_path_alone(i);
}

// The first way down that is clear of all that does not move and can be reached past it.
bool GoalFeasibility::find_descent(PositionerIndex i) {
    if (away(i)) return false;
    List<Angles> unreachable;
    for (const auto &[descent, cost] : descents_of(i)) {
        const Angles above = descent.above(0);
        const bool known = std::any_of(unreachable.begin(), unreachable.end(), [&](Angles a) {
            return a.alpha_rad == above.alpha_rad && a.beta_rad == above.beta_rad;
        });
        if (known || !inside_travel(i, goals_[i].angles, descent)) continue;
        if (blocked(i, Legs(body(i), goals_[i].angles, descent)).any) continue;
        set_goal(i, goals_[i].angles, descent);
        if (find_path_alone(i)) return true;
        unreachable.push_back(above);
    }
    return false;
}

// Gives up a goal that cannot be had whatever the others do, and says why.
bool GoalFeasibility::give_up(PositionerIndex i) {
    const Angles goal = goals_[i].angles;
    if (!inside_travel(i, goal)) return move_away(i, Refusal::goal_beyond_travel, {});
    if (const Blocked found = blocked(i, Legs(body(i), goal)); found.any)
        return move_away(i, Refusal::goal_blocked, found);
    if (!inside_travel(i, goal, lowest(i))) return move_away(i, Refusal::approach_beyond_travel, {});
    if (const Blocked found = blocked(i, Legs(body(i), goal, lowest(i))); found.any)
        return move_away(i, Refusal::approach_blocked, found);
    return move_away(i, Refusal::no_way_alone, {});
}

// What touches what where two goals cannot both be had.
Refusal GoalFeasibility::meeting(PositionerIndex i, PositionerIndex j) const {
    const Legs at_i(body(i), goals_[i].angles), at_j(body(j), goals_[j].angles);
    if (!stay_apart(at_i, at_j, need_mm_)) return Refusal::goal_taken;
    if (!stay_apart(Legs(body(i), goals_[i].angles, lowest(i)), at_j, need_mm_))
        return Refusal::approach_at_goal;
    if (!stay_apart(at_i, Legs(body(j), goals_[j].angles, lowest(j)), need_mm_))
        return Refusal::goal_on_approach;
    return Refusal::approach_taken;
}

// Whom outside of a group the legs of one of its members touch.
List<PositionerIndex> GoalFeasibility::blockers(PositionerIndex i, const Legs &legs,
                                                const List<PositionerIndex> &group) const {
    List<PositionerIndex> out;
    for (const PositionerIndex j : near(i))
        if (!away(j) && !group.contains(j) && !apart(i, legs, j, goals_[j].legs)) out.push_back(j);
    return out;
}

// What a positioner of a group may do past all that is at rest; and past all others, if they are there.
GoalFeasibility::Open GoalFeasibility::open(PositionerIndex i, const List<PositionerIndex> &group,
                                            bool alone) {
    const Descent before = descent(i);
    Open out{i, {}, {}};
    for (const RatedDescent &way : descents_of(i)) {
        if (!inside_travel(i, goals_[i].angles, way.descent)) continue;
        const Legs legs(body(i), goals_[i].angles, way.descent);
        if ((!alone && !blockers(i, legs, group).empty()) || blocked(i, legs).any) continue;
        set_goal(i, goals_[i].angles, way.descent);
        if (!find_path_alone(i)) continue;
        out.ways.push_back(way);
        out.legs.push_back(legs);
    }
    take(i, before);
    return out;
}

List<GoalFeasibility::Open> GoalFeasibility::open_all(const List<PositionerIndex> &group, bool alone) {
    List<Open> all;
    for (const PositionerIndex i : group) all.push_back(open(i, group, alone));
    return all;
}

// A way for each; empty: there are none that go together.
List<int> GoalFeasibility::cheapest(const List<Open> &all) const {
    const auto clear = [this](PositionerIndex i, const Legs &mine, PositionerIndex j, const Legs &theirs) {
        return apart(i, mine, j, theirs);
    };
    return Combination(all, clear).cheapest();
}

// New descents for all of a group, such that none of them touches anything; false: there are none.
bool GoalFeasibility::rearrange(const List<PositionerIndex> &group) {
    const List<Open> all = open_all(group, false);
    const List<int> ways = cheapest(all);
    for (int k = 0; k < ways.size(); ++k) take(group[k], all[k].ways[ways[k]].descent);
    return !ways.empty();
}

// Together with those that are in the way of what the group would do if it were alone.
bool GoalFeasibility::rearrange_with_blockers(const List<PositionerIndex> &group) {
    const List<Open> all = open_all(group, true);
    const List<int> ways = cheapest(all);
    List<PositionerIndex> wider = group;
    for (int k = 0; k < ways.size(); ++k)
        for (const PositionerIndex j : blockers(group[k], all[k].legs[ways[k]], wider)) wider.push_back(j);
    return wider.size() > group.size() && wider.size() <= largest_group && rearrange(wider);
}

// Takes one pair apart that touches; each success leaves fewer such pairs.
bool GoalFeasibility::rearrange_some(const List<List<PositionerIndex>, PositionerIndex> &rivals) {
    for (const bool wider : {false, true})
        for (const PositionerIndex i : places())
            for (const PositionerIndex j : rivals[i]) {
                if (j < i || meeting(i, j) == Refusal::goal_taken) continue;
                if (wider ? rearrange_with_blockers({i, j}) : rearrange({i, j})) return true;
            }
    return false;
}

// A descent that had to differ for a neighbour that has given up its goal since need not.
void GoalFeasibility::relax() {
    for (const PositionerIndex i : places())
        if (!away(i) && descends_otherwise(i)) rearrange({i});
}

} // namespace fl::planning
