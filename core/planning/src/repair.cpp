#include "repair.hpp"

#include <algorithm>
#include <numeric>

namespace fl::planning {
namespace {

constexpr int any_cost = 1 << 25;  // more than any way costs
constexpr int meeting_cost = 1000; // per step
constexpr int tidy_cost = 1 << 20; // per step: as good as forbidden
constexpr int way_itself = 400;    // moves, bends and waits cost about so much
constexpr int longest_hold = 24;   // steps
constexpr int most_joint_nodes = 60000;
constexpr int dance = 60;      // cost above the least
constexpr int joint_every = 6; // of the repairs around a pair, one is a joint search
constexpr int more_time = 4;   // a deadline grows by the first one over this
constexpr int hurry_rounds = 32;
constexpr int patience = 16;        // repairs around a pair without success before the deadline grows
constexpr int rounds_per_robot = 8; // repairs before somebody is given up, per positioner, and at least ...
constexpr int least_rounds = 2000;

} // namespace

void Repair::first_ways() {
    std::vector<int> order(static_cast<size_t>(team_.size()));
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int i, int j) {
        return team_.at(i).robot.travel_steps() > team_.at(j).robot.travel_steps();
    });
    for (int i : order)
        if (team_.at(i).still) team_.stand_still(i);
    for (int i : order)
        while (!team_.at(i).still && !team_.seek(i, {}, any_cost, {}, search_))
            team_.allow(i, team_.at(i).deadline + 1);
    for (int i : order) team_.count_meetings(i);
    statistics_.first_conflicts = team_.meetings();
}

std::vector<std::pair<int, int>> Repair::pairs() const {
    std::vector<std::pair<int, int>> out;
    for (int i = 0; i < team_.size(); ++i)
        for (const Meeting &m : team_.at(i).meetings)
            if (m.other > i) out.emplace_back(i, m.other);
    return out;
}

bool Repair::run(int last_steps) {
    const double most = settings_.effort * std::max(least_rounds, rounds_per_robot * team_.size());
    last_steps_ = last_steps;
    first_steps_ = team_.steps();
    return rounds(static_cast<int>(most));
}

bool Repair::rounds(int most) {
    for (int k = 0; k < most; ++k) {
        const auto all = pairs();
        if (all.empty()) return true;
        round(all[static_cast<size_t>(random_.below(static_cast<int>(all.size())))]);
        ++statistics_.repairs;
    }
    return team_.meetings() == 0;
}

Repair::Group Repair::choose(std::pair<int, int> pair) {
    Group group{{pair.first, pair.second}, {}, 0};
    for (int more = random_.below(7); more > 0; --more) {
        const auto &near = team_.at(random_.chance(50) ? pair.first : pair.second).neighbours;
        const int among = std::min(static_cast<int>(near.size()), 8);
        const int pick = near[static_cast<size_t>(random_.below(among))];
        if (std::find(group.robots.begin(), group.robots.end(), pick) == group.robots.end())
            group.robots.push_back(pick);
    }
    remember(group);
    if (random_.chance(50))
        random_.shuffle(group.robots);
    else
        std::stable_sort(group.robots.begin(), group.robots.end(), [&](int i, int j) {
            return team_.at(i).robot.travel_steps() > team_.at(j).robot.travel_steps();
        });
    return group;
}

void Repair::remember(Group &group) const {
    group.meetings = touching(group);
    group.before.clear();
    for (int i : group.robots) group.before.push_back(team_.remember(i));
}

// Pairs that meet with at least one of them in the group.
int Repair::touching(const Group &group) const {
    int sum = 0;
    for (int i : group.robots)
        for (const Meeting &m : team_.at(i).meetings) {
            const bool inside =
                std::find(group.robots.begin(), group.robots.end(), m.other) != group.robots.end();
            sum += inside ? 1 : 2;
        }
    return sum / 2;
}

void Repair::forget_ways(const Group &group) {
    const int choice = random_.below(4);
    for (int i : group.robots) {
        Member &m = team_.at(i);
        m.presence = choice == 0 ? Presence::absent : choice == 1 ? Presence::standing : Presence::way;
        m.cost = choice == 2 ? meeting_cost / 10 : meeting_cost;
    }
}

// Half of the members now and then find it dear to stretch their arms: that leads to other ways.
Costs Repair::random_costs(const Robot &robot) {
    Costs costs;
    const int dear = 1 + random_.below(20);
    for (int line = 0; line < robot.beta().size(); ++line)
        costs.beta.push_back(static_cast<int>(dear * (1.0 + robot.beta().turn(line).c)));
    return costs;
}

// Early or late, and now and then with a wait at one end: who interlock need the right order in time.
Mode Repair::random_mode(const Robot &robot, int deadline) {
    Mode mode{random_.chance(50), 0};
    const int slack = std::min(deadline - robot.travel_steps(), longest_hold);
    if (slack > 0 && random_.chance(50)) mode.hold = random_.below(slack + 1);
    return mode;
}

bool Repair::replan(const std::vector<int> &robots, int most) {
    const bool dice = random_.chance(60);
    for (int i : robots) {
        Member &m = team_.at(i);
        const Costs costs = dice && random_.chance(50) ? random_costs(m.robot) : Costs{};
        ++statistics_.searches;
        if (!team_.seek(i, costs, most, random_mode(m.robot, m.deadline), search_)) return false;
        m.cost = meeting_cost;
    }
    return true;
}

void Repair::take_back(Group &group) {
    for (Memory &memory : group.before) {
        team_.at(memory.robot).cost = meeting_cost;
        team_.restore(std::move(memory));
    }
    for (int i : group.robots) team_.count_meetings(i);
}

void Repair::judge(std::pair<int, int> pair, const Group &group, int meetings_now) {
    if (meetings_now < group.meetings) {
        for (int i : group.robots) team_.at(i).tries = 0;
        return;
    }
    for (int i : {pair.first, pair.second}) ++team_.at(i).tries;
    if (std::min(team_.at(pair.first).tries, team_.at(pair.second).tries) < patience) return;
    for (int i : {pair.first, pair.second}) team_.at(i).tries = 0;
    give_time(pair);
}

// To a pair that resists, and to those around it: knots need time, and with plenty of it they come undone at
// once.
void Repair::give_time(std::pair<int, int> pair) {
    const int deadline = std::max(8, first_steps_ / more_time) +
                         std::max(team_.at(pair.first).deadline, team_.at(pair.second).deadline);
    if (deadline > last_steps_) return;
    for (int i : {pair.first, pair.second}) {
        const auto &near = team_.at(i).neighbours;
        team_.allow(i, deadline);
        for (size_t k = 0; k < std::min(near.size(), size_t{8}); ++k)
            team_.allow(near[k], std::max(deadline, team_.at(near[k]).deadline));
    }
}

// A way that meets others more often than the whole group did is not worth looking for.
int Repair::affordable(const Group &group) const {
    int steps = 1;
    for (int i : group.robots)
        for (const Meeting &m : team_.at(i).meetings) steps += m.steps;
    return steps * meeting_cost + way_itself;
}

void Repair::round(std::pair<int, int> pair) {
    const int tries = std::min(team_.at(pair.first).tries, team_.at(pair.second).tries);
    if (tries % joint_every == joint_every - 1) return joint_round(pair);
    Group group = choose(pair);
    const int most = affordable(group);
    forget_ways(group);
    if (!replan(group.robots, most)) {
        take_back(group);
        return judge(pair, group, group.meetings);
    }
    for (int i : group.robots) team_.count_meetings(i);
    const int now = touching(group);
    if (now > group.meetings) take_back(group);
    judge(pair, group, now);
}

// The pair, and now and then a third: three arms can lock each other in a ring.
std::vector<int> Repair::choose_joint(std::pair<int, int> pair) {
    std::vector<int> knot{pair.first, pair.second};
    const int tries = std::min(team_.at(pair.first).tries, team_.at(pair.second).tries);
    if (tries < 2 * joint_every || random_.chance(40)) return knot;
    const auto &near = team_.at(random_.chance(50) ? pair.first : pair.second).neighbours;
    const int third = near[static_cast<size_t>(random_.below(std::min(static_cast<int>(near.size()), 6)))];
    if (third != pair.first && third != pair.second) knot.push_back(third);
    return knot;
}

// Gives a knot the ways that the joint search found, and adds to the group whom they meet on them.
void Repair::set_joint(const std::vector<int> &knot, Group &group) {
    for (size_t k = 0; k < knot.size(); ++k) {
        team_.set_way(knot[k], joint_.way(k));
        team_.at(knot[k]).still = false;
    }
    for (int i : knot) team_.count_meetings(i);
    for (int i : knot)
        for (const Meeting &m : team_.at(i).meetings)
            if (std::find(group.robots.begin(), group.robots.end(), m.other) == group.robots.end())
                group.robots.push_back(m.other);
}

// A pair that resists: all at once, as if some neighbours were not there, and then whoever is in their way.
void Repair::joint_round(std::pair<int, int> pair) {
    const std::vector<int> knot = choose_joint(pair);
    Group group = choose(pair);
    forget_ways(group);
    const int most_nodes = knot.size() == 2 ? most_joint_nodes : 2 * most_joint_nodes;
    const bool found = team_.seek_joint(knot, random_.chance(70), most_nodes, joint_);
    take_back(group);
    if (!found) return judge(pair, group, group.meetings);
    std::vector<Memory> before;
    for (int i : knot) before.push_back(team_.remember(i));
    std::erase_if(group.robots, [&](int i) { return std::find(knot.begin(), knot.end(), i) != knot.end(); });
    set_joint(knot, group);
    std::erase_if(group.robots, [&](int i) { return std::find(knot.begin(), knot.end(), i) != knot.end(); });
    const std::vector<int> others = group.robots;
    for (Memory &memory : before) team_.restore(std::move(memory));
    for (int i : knot) team_.count_meetings(i);
    group.robots.insert(group.robots.end(), knot.begin(), knot.end());
    remember(group);
    set_joint(knot, group);
    forget_ways({others, {}, 0});
    const bool all = replan(others, any_cost);
    for (int i : group.robots) team_.count_meetings(i);
    const int now = touching(group);
    if (!all || now > group.meetings) take_back(group);
    judge(pair, group, all ? now : group.meetings);
}

int Repair::arrival() const {
    int last = 0;
    for (int i = 0; i < team_.size(); ++i) last = std::max(last, team_.arrival(i));
    return last;
}

// Those who were given more time in need may do with less of it: halves what is above the wish.
void Repair::hurry(int wanted_steps) {
    last_steps_ = 0; // nobody gets more time now
    for (int low = wanted_steps; arrival() > low;) {
        std::vector<Memory> before;
        std::vector<int> deadlines;
        for (int i = 0; i < team_.size(); ++i) {
            before.push_back(team_.remember(i));
            deadlines.push_back(team_.at(i).deadline);
        }
        const int deadline = (low + arrival()) / 2;
        if (squeeze(deadline)) continue;
        for (Memory &memory : before) team_.restore(std::move(memory));
        for (int i = 0; i < team_.size(); ++i) {
            team_.at(i).deadline = deadlines[static_cast<size_t>(i)];
            team_.count_meetings(i);
        }
        low = deadline + 1;
    }
}

bool Repair::squeeze(int deadline) {
    for (int i = 0; i < team_.size(); ++i) {
        team_.at(i).deadline = std::min(team_.at(i).deadline, deadline);
        team_.at(i).tries = 0;
        if (team_.arrival(i) <= deadline) continue;
        ++statistics_.searches;
        if (!team_.seek(i, {}, any_cost, {}, search_)) return false;
        team_.count_meetings(i);
    }
    return rounds(static_cast<int>(settings_.effort * hurry_rounds));
}

int Repair::way_cost(const Member &member, const Costs &costs) const {
    int cost = 0;
    Cell last{};
    for (size_t k = 0; k < member.way.size(); ++k) {
        const Cell here = member.way[k], next = member.way[std::min(k + 1, member.way.size() - 1)];
        const Cell v{next.alpha - here.alpha, next.beta - here.beta};
        cost += costs.move * (std::abs(v.alpha) + std::abs(v.beta));
        cost += costs.bend * ((v.alpha != last.alpha) + (v.beta != last.beta));
        if (v == Cell{} && !(here == member.way.back())) cost += costs.wait;
        last = v;
    }
    return cost;
}

// No way is cheaper than both axes straight from start to goal.
int Repair::least_cost(const Robot &robot, const Costs &costs) {
    const Cell from = robot.start(), to = robot.goal();
    const int alpha = std::abs(to.alpha - from.alpha), beta = std::abs(to.beta - from.beta);
    return costs.move * (alpha + beta) + 2 * costs.bend * ((alpha > 0) + (beta > 0));
}

void Repair::tidy_one(int robot, const Costs &costs) {
    const Member &member = team_.at(robot);
    if (member.still) return;
    const int cost = way_cost(member, costs);
    if (cost <= least_cost(member.robot, costs)) return;
    ++statistics_.searches;
    team_.seek(robot, costs, cost, {}, search_);
}

void Repair::tidy() {
    const Costs costs{2, 4, 1, {}}; // few corners: each costs three points on the bus
    for (int i = 0; i < team_.size(); ++i) team_.at(i).cost = tidy_cost;
    for (int i = 0; i < team_.size(); ++i) tidy_one(i, costs);
    // whoever still dances may have room now that the others are tidy
    for (int i = team_.size() - 1; i >= 0; --i)
        if (way_cost(team_.at(i), costs) > least_cost(team_.at(i).robot, costs) + dance) tidy_one(i, costs);
}

} // namespace fl::planning
