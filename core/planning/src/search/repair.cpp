#include "search/repair.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

constexpr int conflict_cost = 1000; // per step
constexpr int tidy_cost = 1 << 20;  // per step: as good as forbidden
constexpr int path_itself = 400;    // moves, velocity changes and waits cost about so much
constexpr int longest_hold = 24;    // steps
constexpr int least_affordable = 4; // steps in conflict
// Of a joint search of two; twice as many after each one in vain: what it takes is not known before. Of three
// as many as the second one of two. All of a round together take about half a second at
// most, and as much when paths are hurried.
constexpr int least_joint_nodes = 8000, most_doublings = 3, joint_of_two = 4;
constexpr int flood_nodes = 16000;      // of a search that keeps to a flood ...
constexpr int nodes_of_a_flood = 8000;  // ... which takes as long as one of so many
constexpr int flood_nodes_alone = 4000; // where a knot grows, which may begin otherwise
constexpr int always_flooded = 30;      // repairs in vain, in which all joint searches of two keep to a flood
constexpr int most_states = 1000; // of one search in a repair: another group is tried rather than all ways
// Without a first look for a path that nothing is in the way of. A straighter path is found soon, or its gain
// is not worth the search.
constexpr Mode tidying{false, 0, 200, 0};
constexpr Mode guided{false, 0, 0, 0};
constexpr int tidy_enough = 24; // cost above the least: six corners are not worth a search
// Of the speed of an axis: each is two points on the bus, where an axis shall have no more than 40.
constexpr int many_changes = 13;
// Of the repairs around a pair, one is a joint search; where a knot grows, and few are there, more of them.
constexpr int joint_every = 12, joint_every_alone = 3;
constexpr int more_time = 4;     // a deadline grows by the first one over this
constexpr int late_patience = 8; // repairs around a pair that meets only if one is late, before it is spared
constexpr int patience = 16;     // repairs around a pair without success before the deadline grows
constexpr int rounds_per_robot = 8; // repairs before one is given up, per positioner, and at least ...
constexpr int least_rounds = 2000;
// States that are looked at since fewer paths met, before one is given up: about a second per million. Where
// it has gone on in 66 plans of 500, at most 0.36 million came between.
constexpr std::int64_t least_vain = 1000000, vain_per_robot = 2000;
// Repairs since fewer paths met, before one is given up; so many more for each pair that meets. Counted in
// nine slow plans of 500 at 2.5 and 3.0 mm: no knot that came undone took more than 452.
constexpr int least_repairs_in_vain = 1000, repairs_in_vain_per_pair = 100;
constexpr int repairs_before_a_proof = 100;
// Of a group, besides the two that resist: at most so many before some repairs around these were in vain, and
// after all of them. A small group is planned soon, and most pairs come apart in one.
struct GroupSize {
    int tries, others;
};
constexpr GroupSize small_groups[] = {{2, 2}, {5, 4}};
constexpr int others_of_a_group = 6;
constexpr int last_rounds = 40;       // repairs that are made even when there is no time left
constexpr int single_steps = 16;      // by which a first deadline grows, before it grows faster
constexpr int longest_first_path = 3; // times all steps: who has no path by then has none

// Of the speed of one axis; of the one with more of them.
int velocity_changes(const List<Cell> &path) {
    int alpha = 0, beta = 0;
    Cell last{};
    for (int k = 1; k < path.size(); ++k) {
        const Cell v{path[k].alpha - path[k - 1].alpha, path[k].beta - path[k - 1].beta};
        alpha += v.alpha != last.alpha;
        beta += v.beta != last.beta;
        last = v;
    }
    return std::max(alpha, beta);
}

} // namespace

// All positioners by the steps they travel, the longest first.
List<PathIndex> Repair::longest_first() const {
    List<PathIndex> order;
    for (const PathIndex i : paths_.places()) order.push_back(i);
    std::stable_sort(order.begin(), order.end(), [&](PathIndex i, PathIndex j) {
        return paths_.at(i).robot.travel_steps() > paths_.at(j).robot.travel_steps();
    });
    return order;
}

List<PathIndex> Repair::first_paths() {
    List<PathIndex> without;
    const List<PathIndex> order = longest_first();
    for (const PathIndex i : order)
        if (paths_.at(i).still) paths_.keep_still(i);
    const int most = longest_first_path * (paths_.steps() + longest_hold);
    int found = 0;
    for (const PathIndex i : order) {
        const bool has_one = paths_.at(i).presence == Presence::path; // still, or taken over
        if (!has_one && !first_path(i, most)) without.push_back(i);
        settings_.watch("finding paths", ++found, paths_.size());
    }
    if (!without.empty()) return without;
    for (const PathIndex i : order) paths_.count_conflicts(i);
    statistics_.first_conflicts = paths_.conflicts();
    return without;
}

// A path by the first deadline that allows one, of at most so many steps.
bool Repair::first_path(PathIndex i, int most) {
    for (int tries = 1; !paths_.seek(i, {}, any_cost, {}, search_); ++tries) {
        const int deadline = paths_.at(i).deadline;
        if (deadline >= most) return false;
        paths_.allow(i, deadline + (tries < single_steps ? 1 : 1 + deadline / more_time));
    }
    return true;
}

List<Repair::Pair> Repair::pairs() const {
    List<Pair> out;
    for (const PathIndex i : paths_.places())
        for (const PathConflict &c : paths_.at(i).conflicts)
            if (c.other > i) out.push_back({i, c.other});
    return out;
}

bool Repair::run(int first_steps, int last_steps) {
    const double most = effort_ * std::max(least_rounds, rounds_per_robot * paths_.size());
    last_steps_ = most_steps_ = last_steps;
    first_steps_ = first_steps;
    joint_left_ = most_joint_nodes;
    if (part(static_cast<int>(most))) return true;
    // those that meet, and all around them, are on time now
    bool fewer = false;
    for (const PathIndex i : paths_.places())
        if (!paths_.at(i).conflicts.empty()) fewer |= spare_around(i);
    return fewer && rounds(static_cast<int>(most));
}

// Spares one and all that it can meet.
bool Repair::be_on_time(PathIndex i) {
    bool any = false;
    for (const PathIndex j : paths_.at(i).neighbours) any |= paths_.spare(i, j);
    if (any) paths_.count_conflicts(i);
    return any;
}

bool Repair::spare_around(PathIndex i) {
    bool any = be_on_time(i);
    for (const PathIndex j : paths_.at(i).neighbours) any |= be_on_time(j);
    return any;
}

// After a while without success there is none to be expected: one that is locked in has no way at all.
std::int64_t Repair::most_in_vain() const {
    const std::int64_t states = std::max(least_vain, vain_per_robot * paths_.size());
    return static_cast<std::int64_t>(effort_ * static_cast<double>(states));
}

int Repair::most_repairs_in_vain() const {
    return static_cast<int>(effort_ *
                            (least_repairs_in_vain + repairs_in_vain_per_pair * paths_.conflicts()));
}

// Where repairs are in vain for a while it is looked whether two lock each other: then more are of no use.
void Repair::find_locked() {
    if (in_vain_ != repairs_before_a_proof || last_steps_ == 0 || most_work_ != unlimited) return;
    for (const Pair pair : pairs())
        if (lock_(pair.first, pair.second)) locked_.push_back(pair);
}

// Whether the plan shall come to an end; once it shall, for good.
bool Repair::enough() { return statistics_.cut_short = statistics_.cut_short || settings_.enough(); }

bool Repair::rounds(int most) {
    int fewest = paths_.conflicts();
    std::int64_t since = expansions();
    in_vain_ = 0;
    for (int k = 0; k < most && expansions() - since < most_in_vain(); ++k) {
        if (in_vain_++ > most_repairs_in_vain() / vain_share_) break;
        find_locked();
        if (!locked_.empty()) break;
        if ((enough() && k >= last_rounds) || work() > most_work_) break;
        const auto all = pairs();
        if (all.empty()) return true;
        round(all[random_.below(all.size())]);
        ++statistics_.repairs;
        if (paths_.conflicts() < fewest) {
            fewest = paths_.conflicts();
            since = expansions();
            in_vain_ = 0;
        }
        const int most_at_once = std::max(statistics_.first_conflicts, paths_.conflicts());
        settings_.watch("parting paths that meet", most_at_once - paths_.conflicts(), most_at_once);
    }
    return paths_.conflicts() == 0;
}

// One of the nearest neighbours of one of the two.
PathIndex Repair::near_one_of(Pair pair, int among) {
    const auto &near = paths_.at(random_.chance(50) ? pair.first : pair.second).neighbours;
    return near[random_.below(std::min(near.size(), among))];
}

int Repair::most_others(Pair pair) const {
    for (const GroupSize &size : small_groups)
        if (tries(pair) < size.tries) return size.others;
    return others_of_a_group;
}

Repair::Group Repair::choose(Pair pair) {
    Group group{{pair.first, pair.second}, {}, 0};
    for (int more = random_.below(most_others(pair) + 1); more > 0; --more) {
        const PathIndex pick = near_one_of(pair, near_by);
        if (is_there(pick) && !group.members.contains(pick)) group.members.push_back(pick);
    }
    save(group);
    order(group.members);
    return group;
}

// By chance, or the longest travel first.
void Repair::order(List<PathIndex> &members) {
    if (random_.chance(50)) return random_.shuffle(members);
    std::stable_sort(members.begin(), members.end(), [&](PathIndex i, PathIndex j) {
        return paths_.at(i).robot.travel_steps() > paths_.at(j).robot.travel_steps();
    });
}

void Repair::save(Group &group) const {
    group.conflicts = touching(group);
    group.before.clear();
    for (const PathIndex i : group.members) group.before.push_back(paths_.save(i));
}

// Pairs in conflict with at least one of them in the group.
int Repair::touching(const Group &group) const {
    int sum = 0;
    for (const PathIndex i : group.members)
        for (const PathConflict &c : paths_.at(i).conflicts) sum += group.members.contains(c.other) ? 1 : 2;
    return sum / 2;
}

void Repair::forget_paths(const List<PathIndex> &members) {
    const int choice = random_.below(4);
    for (const PathIndex i : members) {
        Member &m = paths_.at(i);
        m.presence = choice == 0 ? Presence::absent : choice == 1 ? Presence::waiting : Presence::path;
        m.cost = choice == 2 ? conflict_cost / 10 : conflict_cost;
    }
}

// Half of the members now and then find it dear to stretch their arms: that leads to other paths.
Costs Repair::random_costs(const Robot &robot) {
    Costs costs;
    const int dear = 1 + random_.below(20);
    for (int line = 0; line < robot.beta().size(); ++line)
        costs.beta.push_back(static_cast<int>(dear * (1.0 + robot.beta().turn(line).c)));
    return costs;
}

// Early or late, and now and then with a wait at one end: those that interlock need the right order in time.
Mode Repair::random_mode(const Robot &robot, int deadline) {
    Mode mode{random_.chance(50), 0, most_states, 0};
    const int slack = std::min(deadline - robot.travel_steps(), longest_hold);
    if (slack > 0 && random_.chance(50)) mode.hold = random_.below(slack + 1);
    return mode;
}

// False as soon as a path costs too much, or too many pairs are in conflict.
bool Repair::replan(const List<PathIndex> &members, int most_cost, int most_pairs) {
    List<PathIndex> to_come = members;
    int pairs = 0;
    const bool dice = random_.chance(85);
    for (const PathIndex i : members) {
        Member &m = paths_.at(i);
        const Costs costs = dice && random_.chance(50) ? random_costs(m.robot) : Costs{};
        ++statistics_.searches;
        if (!paths_.seek(i, costs, most_cost, random_mode(m.robot, m.deadline), search_)) return false;
        m.cost = conflict_cost;
        to_come.erase(to_come.begin());
        paths_.count_conflicts(i);
        for (const PathConflict &c : m.conflicts) pairs += to_come.contains(c.other) ? 0 : 1;
        if (pairs > most_pairs) return false;
    }
    return true;
}

void Repair::take_back(Group &group) {
    for (const PathIndex i : group.members) paths_.at(i).cost = conflict_cost;
    paths_.restore_all(group.before);
}

int Repair::tries(Pair pair) const {
    return std::min(paths_.at(pair.first).tries, paths_.at(pair.second).tries);
}

void Repair::judge(Pair pair, const Group &group, int conflicts_now) {
    if (conflicts_now < group.conflicts) {
        for (const PathIndex i : group.members) paths_.at(i).tries = paths_.at(i).joint_in_vain = 0;
        return;
    }
    for (const PathIndex i : {pair.first, pair.second}) ++paths_.at(i).tries;
    if (paths_.only_late(pair.first, pair.second)) return judge_late(pair);
    if (tries(pair) < patience) return;
    for (const PathIndex i : {pair.first, pair.second}) {
        paths_.at(i).tries = 0;
        if (last_steps_ > 0) be_on_time(i);
    }
    give_time(pair);
}

// A pair that conflicts only if one of the two is late is left so after a while: it is worth no more.
void Repair::judge_late(Pair pair) {
    auto &in_vain = paths_.at(pair.first).in_vain;
    in_vain.push_back(pair.second);
    const auto most = std::max<std::int64_t>(1, late_patience - 3 * statistics_.repairs / paths_.size());
    if (std::count(in_vain.begin(), in_vain.end(), pair.second) < most || last_steps_ == 0) return;
    for (const PathIndex i : {pair.first, pair.second}) paths_.at(i).tries = 0;
    paths_.spare(pair.first, pair.second);
    paths_.count_conflicts(pair.first);
}

// To a pair that resists, and to those around it: arms that interlock need time, and with plenty of it they
// come apart at once.
void Repair::give_time(Pair pair) {
    const int deadline = std::max(8, first_steps_ / more_time) +
                         std::max(paths_.at(pair.first).deadline, paths_.at(pair.second).deadline);
    if (deadline > last_steps_) return;
    for (const PathIndex i : {pair.first, pair.second}) {
        const auto &near = paths_.at(i).neighbours;
        paths_.allow(i, deadline);
        for (int k = 0; k < std::min(near.size(), near_by); ++k)
            paths_.allow(near[k], std::max(deadline, paths_.at(near[k]).deadline));
    }
}

// A path with more conflicts than the whole group had is not worth looking for, but where there are few: a
// group may well trade its conflict for another.
int Repair::affordable(const Group &group) const {
    int steps = 1;
    for (const PathIndex i : group.members)
        for (const PathConflict &c : paths_.at(i).conflicts) steps += c.steps;
    return std::max(steps, least_affordable) * conflict_cost + path_itself;
}

// Whether it was given more time than all, or hurries, or few are there: else a joint search takes long, and
// seldom finds a way.
bool Repair::has_time(Pair pair) const {
    return last_steps_ == 0 || alone_ ||
           2 * std::max(paths_.at(pair.first).deadline, paths_.at(pair.second).deadline) > 3 * first_steps_;
}

void Repair::round(Pair pair) {
    const int every = alone_ ? joint_every_alone : joint_every;
    const bool joint = joint_left_ > 0 && has_time(pair) && tries(pair) % every == every - 1;
    if (joint && !paths_.only_late(pair.first, pair.second)) return joint_round(pair);
    Group group = choose(pair);
    const int most = affordable(group);
    forget_paths(group.members);
    if (!replan(group.members, most, group.conflicts)) {
        take_back(group);
        return judge(pair, group, group.conflicts);
    }
    const int now = touching(group);
    if (now > group.conflicts) take_back(group);
    judge(pair, group, now);
}

int Repair::joint_in_vain(Pair pair) const {
    return std::min(paths_.at(pair.first).joint_in_vain, paths_.at(pair.second).joint_in_vain);
}

// That a joint search looks at, at most.
int Repair::joint_nodes(const List<PathIndex> &joint) const {
    if (joint.size() > 2) return 2 * least_joint_nodes;
    return least_joint_nodes << std::min(joint_in_vain({joint[0], joint[1]}), most_doublings);
}

// The pair, and now and then a third: three arms can lock each other in a ring.
List<PathIndex> Repair::choose_joint(Pair pair) {
    List<PathIndex> joint{pair.first, pair.second};
    if (alone_ || joint_in_vain(pair) < joint_of_two || random_.chance(40)) return joint;
    const PathIndex third = near_one_of(pair, 6);
    if (is_there(third) && third != pair.first && third != pair.second) joint.push_back(third);
    return joint;
}

// Whether a joint search of these keeps to a flood. That sees arms nearer than they are: where it finds no
// way for long, every other search does without.
bool Repair::shall_flood(const List<PathIndex> &joint) {
    if (joint.size() > 2) return false;
    const bool always = alone_ || last_steps_ == 0 || in_vain_ <= always_flooded;
    return (always || random_.chance(50)) && paths_.can_flood(joint);
}

// Gives the positioners of a joint search the paths that it found.
void Repair::set_joint(const List<PathIndex> &joint) {
    for (int k = 0; k < joint.size(); ++k) {
        paths_.set_path(joint[k], joint_.path(k));
        paths_.at(joint[k]).still = false;
    }
    for (const PathIndex i : joint) paths_.count_conflicts(i);
}

// The same, and adds to the group those with which these conflict.
void Repair::set_joint(const List<PathIndex> &joint, Group &group) {
    set_joint(joint);
    for (const PathIndex i : joint)
        for (const PathConflict &c : paths_.at(i).conflicts)
            if (!group.members.contains(c.other)) group.members.push_back(c.other);
}

// The group without the joint positioners, and with all that conflict with their new paths, which are taken
// back again.
List<PathIndex> Repair::drawn_in(const List<PathIndex> &joint, Group &group) {
    List<SavedPath> before;
    for (const PathIndex i : joint) before.push_back(paths_.save(i));
    const auto in_joint = [&](PathIndex i) { return joint.contains(i); };
    group.members.erase_if(in_joint);
    set_joint(joint, group);
    group.members.erase_if(in_joint);
    for (SavedPath &saved : before) paths_.restore(std::move(saved));
    for (const PathIndex i : joint) paths_.count_conflicts(i);
    return group.members;
}

// A pair that resists: all at once, as if some neighbours were not there, and then those that are in their
// way.
void Repair::joint_round(Pair pair) {
    const List<PathIndex> joint = choose_joint(pair);
    Group group = choose(pair);
    forget_paths(group.members);
    const int most_nodes = joint_nodes(joint);
    for (const PathIndex i : {pair.first, pair.second}) ++paths_.at(i).joint_in_vain;
    const bool by_flood = shall_flood(joint);
    floods_ += by_flood;
    const bool found =
        by_flood ? paths_.seek_pair(joint, alone_ && !parts_two_ ? flood_nodes_alone : flood_nodes, joint_)
                 : paths_.seek_joint(joint, random_.chance(70), most_nodes, joint_);
    joint_left_ -= by_flood ? nodes_of_a_flood : joint_.nodes();
    take_back(group);
    if (!found) return judge(pair, group, group.conflicts);
    const List<PathIndex> others = drawn_in(joint, group);
    group.members.insert(group.members.end(), joint.begin(), joint.end());
    save(group);
    set_joint(joint, group);
    forget_paths(others);
    const bool all = replan(others, any_cost, group.conflicts);
    for (const PathIndex i : group.members) paths_.count_conflicts(i);
    const int now = touching(group);
    if (!all || now > group.conflicts) take_back(group);
    judge(pair, group, all ? now : group.conflicts);
}

int Repair::path_cost(const Member &member, const Costs &costs) const {
    int cost = 0;
    Cell last{};
    const List<Cell> &path = member.path;
    for (int k = 0; k < path.size(); ++k) {
        const Cell here = path[k], next = path[std::min(k + 1, path.size() - 1)];
        const Cell v{next.alpha - here.alpha, next.beta - here.beta};
        cost += costs.move * (std::abs(v.alpha) + std::abs(v.beta));
        cost += costs.velocity_change * ((v.alpha != last.alpha) + (v.beta != last.beta));
        if (v == Cell{} && !(here == path.back())) cost += costs.wait;
        last = v;
    }
    return cost;
}

// No path is cheaper than both axes straight from start to goal.
int Repair::least_cost(const Robot &robot, const Costs &costs) {
    const Cell from = robot.start(), to = robot.goal();
    const int alpha = std::abs(to.alpha - from.alpha), beta = std::abs(to.beta - from.beta);
    return costs.move * (alpha + beta) + 2 * costs.velocity_change * ((alpha > 0) + (beta > 0));
}

void Repair::tidy_one(PathIndex i, const Costs &costs) {
    const Member &member = paths_.at(i);
    if (member.still) return;
    const int cost = path_cost(member, costs);
    if (cost <= least_cost(member.robot, costs) + tidy_enough) return;
    ++statistics_.searches;
    paths_.seek(i, costs, cost, tidying, search_);
}

void Repair::tidy() {
    const Costs costs{2, 4, 1, {}, 2}; // few corners: each costs points on the bus
    const int last = paths_.size() > 0 ? paths_.arrival(last_to_arrive()) : 0;
    for (const PathIndex i : paths_.places()) {
        Member &member = paths_.at(i);
        member.cost = tidy_cost;
        member.deadline = std::min(member.deadline, last); // none shall hold the others up
    }
    paths_.shorten();
    for (const PathIndex i : paths_.places()) {
        if (enough()) return;
        tidy_one(i, costs);
        settings_.watch("straightening paths", i.value() + 1, paths_.size());
    }
    spare_corners();
}

// Those of which an axis would have many points go farther for fewer.
void Repair::spare_corners() {
    const Costs costs{1, 16, 0, {}, 1};
    for (const PathIndex i : paths_.places()) {
        const Member &member = paths_.at(i);
        if (enough() || velocity_changes(member.path) <= many_changes) continue;
        ++statistics_.searches;
        paths_.seek(i, costs, path_cost(member, costs), guided, search_);
    }
}

} // namespace fl::planning
