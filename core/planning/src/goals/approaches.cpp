// Ways down to the goals: of each positioner past what does not move, and of neighbours past each other.
#include "goals/goal_feasibility.hpp"

#include <algorithm>

namespace fl::planning {
namespace {

constexpr int most_tests = 20'000; // of pairs of descents in one group; a pair of positioners has 1296

} // namespace

struct GoalFeasibility::Open {
    PositionerIndex robot;
    List<RatedDescent> ways;
    List<Legs> legs; // of each way
};

namespace {

// One descent for each positioner of a group, so that none of them touch: the cheapest together.
template <class Open> class Combination {
  public:
    Combination(const List<Open> &open, double need_mm) : open_(open), need_mm_(need_mm) {}

    // One way of each; empty: none was found.
    List<int> cheapest() {
        choose(0);
        return best_;
    }

  private:
    bool clear(const Legs &legs) {
        for (int k = 0; k < chosen_.size(); ++k) {
            ++tests_;
            if (!stay_apart(open_[k].legs[chosen_[k]], legs, need_mm_)) return false;
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
            if (!clear(next.legs[way])) continue;
            chosen_.push_back(way);
            choose(now);
            chosen_.pop_back();
        }
    }

    const List<Open> &open_;
    double need_mm_;
    int tests_ = 0, best_cost_ = 0;
    List<int> chosen_, best_;
};

} // namespace

Descent GoalFeasibility::usual(PositionerIndex i) const {
    const double height = row(task_.approach_rad, i);
    return {{height, height}};
}

Descent GoalFeasibility::lowest(PositionerIndex i) const {
    if (task_.least_approach_rad.empty()) return usual(i);
    const double height = row(task_.least_approach_rad, i);
    return {{height, height}};
}

List<RatedDescent> GoalFeasibility::descents_of(PositionerIndex i) const {
    return descents(usual(i).above.alpha_rad, lowest(i).above.alpha_rad, settings_.approach_turns);
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
        const Angles above = descent.above;
        const bool known = std::any_of(unreachable.begin(), unreachable.end(), [&](Angles a) {
            return a.alpha_rad == above.alpha_rad && a.beta_rad == above.beta_rad;
        });
        if (known || !inside_travel(goals_[i].angles, descent)) continue;
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
    if (!inside_travel(goal)) return move_away(i, Refusal::goal_beyond_travel, {});
    if (const Blocked found = blocked(i, Legs(body(i), goal)); found.any)
        return move_away(i, Refusal::goal_blocked, found);
    if (!inside_travel(goal, lowest(i))) return move_away(i, Refusal::approach_beyond_travel, {});
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

bool GoalFeasibility::clear_of_others(PositionerIndex i, const Legs &legs,
                                      const List<PositionerIndex> &group) const {
    return std::all_of(near(i).begin(), near(i).end(), [&](PositionerIndex j) {
        return away(j) || group.contains(j) || stay_apart(legs, goals_[j].legs, need_mm_);
    });
}

// What a positioner of a group may do: it touches nobody outside of the group, and nothing that is at rest.
GoalFeasibility::Open GoalFeasibility::open(PositionerIndex i, const List<PositionerIndex> &group) {
    const Descent before = descent(i);
    Open out{i, {}, {}};
    for (const RatedDescent &way : descents_of(i)) {
        if (!inside_travel(goals_[i].angles, way.descent)) continue;
        const Legs legs(body(i), goals_[i].angles, way.descent);
        if (!clear_of_others(i, legs, group) || blocked(i, legs).any) continue;
        set_goal(i, goals_[i].angles, way.descent);
        if (!find_path_alone(i)) continue;
        out.ways.push_back(way);
        out.legs.push_back(legs);
    }
    take(i, before);
    return out;
}

// New descents for all of a group, such that none of them touches anything; false: there are none.
bool GoalFeasibility::rearrange(const List<PositionerIndex> &group) {
    List<Open> all;
    for (const PositionerIndex i : group) {
        all.push_back(open(i, group));
        if (all.back().ways.empty()) return false;
    }
    const List<int> ways = Combination<Open>(all, need_mm_).cheapest();
    for (int k = 0; k < ways.size(); ++k) take(group[k], all[k].ways[ways[k]].descent);
    return !ways.empty();
}

// With one more neighbour if the two alone cannot do it.
bool GoalFeasibility::rearrange_round(PositionerIndex i, PositionerIndex j) {
    List<PositionerIndex> around = near(i);
    for (const PositionerIndex k : near(j)) around.push_back(k);
    std::sort(around.begin(), around.end());
    around.erase_if([&](PositionerIndex k) { return away(k) || k == i || k == j; });
    for (int k = 0; k < around.size(); ++k)
        if ((k == 0 || around[k] != around[k - 1]) && rearrange({i, j, around[k]})) return true;
    return false;
}

// Takes one pair apart that touches; each success leaves fewer such pairs.
bool GoalFeasibility::rearrange_some(const List<List<PositionerIndex>, PositionerIndex> &rivals) {
    for (const bool wider : {false, true})
        for (const PositionerIndex i : places())
            for (const PositionerIndex j : rivals[i]) {
                const auto rest = [&](PositionerIndex k) { return Legs(body(k), goals_[k].angles); };
                if (j < i || !stay_apart(rest(i), rest(j), need_mm_)) continue; // the goals themselves
                if (wider ? rearrange_round(i, j) : rearrange({i, j})) return true;
            }
    return false;
}

// A descent that had to differ for a neighbour that has given up its goal since need not.
void GoalFeasibility::relax() {
    for (const PositionerIndex i : places())
        if (!away(i) && descends_otherwise(i)) rearrange({i});
}

} // namespace fl::planning
