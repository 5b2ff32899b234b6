#include "cast.hpp"
#include "fiberloom/planning.hpp"
#include "motion.hpp"
#include "repair.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace fl::planning {
namespace {

constexpr int give_up_rounds = 20;

// The facade's work: settle who goes where, find ways for all, give up whoever finds none.
class Planner {
  public:
    Planner(const Bodies &bodies, const Task &task, const Settings &settings)
        : bodies_(bodies), settings_(settings), task_(task), clock_(settings, task),
          cast_(bodies, task, settings, clock_) {}

    Outcome run() {
        cast_.settle();
        for (int round = 0; round < give_up_rounds; ++round)
            if (find_ways()) return outcome();
        return nobody_moves();
    }

  private:
    Team assemble();
    bool find_ways();
    void give_up_some(const Team &team);
    void keep(const Team &team);
    Outcome outcome();
    Outcome nobody_moves();

    const Bodies &bodies_;
    const Settings &settings_;
    const Task &task_;
    Clock clock_;
    Cast cast_;
    std::vector<int> robot_of_; // of each member of the team
    std::vector<Motion> motions_;
    Statistics statistics_;
};

Team Planner::assemble() {
    robot_of_.clear();
    int bound = 0, alone = 0;
    std::vector<Robot> robots;
    for (int i = 0; i < cast_.size(); ++i) {
        if (!cast_.acts(i)) continue;
        robot_of_.push_back(i);
        robots.push_back(cast_.make_robot(i));
        if (cast_.still(i)) continue;
        bound = std::max(bound, robots.back().travel_steps());
        alone = std::max(alone, cast_.steps_alone(i));
    }
    const int steps = std::max(static_cast<int>(std::ceil(bound * settings_.first_deadline)), alone);
    statistics_.bound_steps = bound;
    Team team(cast_.need_mm(), steps);
    for (Robot &robot : robots) team.add(std::move(robot));
    for (size_t m = 0; m < robot_of_.size(); ++m)
        team.at(static_cast<int>(m)).still = cast_.still(robot_of_[m]);
    team.find_neighbours();
    return team;
}

bool Planner::find_ways() {
    Team team = assemble();
    Repair repair(team, settings_, statistics_);
    repair.first_ways();
    const int last = static_cast<int>(settings_.last_deadline * team.steps()) + 20;
    const int wanted = team.steps();
    const bool free = repair.run(last);
    if (free) repair.hurry(wanted);
    if (free) repair.tidy();
    statistics_.expansions += repair.expansions();
    if (free)
        keep(team);
    else
        give_up_some(team);
    return free;
}

// One of each pair that still meets; those with more meetings first.
void Planner::give_up_some(const Team &team) {
    std::vector<std::pair<int, int>> order; // fewer meetings come last
    for (int m = 0; m < team.size(); ++m)
        if (!team.at(m).meetings.empty())
            order.emplace_back(-static_cast<int>(team.at(m).meetings.size()), m);
    std::sort(order.begin(), order.end());
    std::vector<int> gone;
    for (const auto &[meetings, m] : order) {
        const auto &theirs = team.at(m).meetings;
        const auto open = std::find_if(theirs.begin(), theirs.end(), [&](const Meeting &meeting) {
            return std::find(gone.begin(), gone.end(), meeting.other) == gone.end();
        });
        if (open == theirs.end()) continue;
        gone.push_back(m);
        const auto robot = robot_of_[static_cast<size_t>(m)],
                   other = robot_of_[static_cast<size_t>(open->other)];
        cast_.send_to_safe_place(robot, Refusal::no_way, other);
    }
    cast_.settle();
}

void Planner::keep(const Team &team) {
    int last = 0; // the last step in which somebody moves
    for (const Member &m : team.members())
        for (int step = last + 1; step <= team.steps(); ++step)
            if (!(m.way[static_cast<size_t>(step)] == m.way[static_cast<size_t>(step - 1)])) last = step;
    statistics_.steps = last;
    statistics_.step_s = clock_.step_s();
    for (const Angles &start : task_.start) motions_.push_back({{0.0}, {start}});
    for (int m = 0; m < team.size(); ++m)
        if (!team.at(m).still)
            motions_[static_cast<size_t>(robot_of_[static_cast<size_t>(m)])] =
                motion_of(team.at(m).robot, team.at(m).way, last, clock_,
                          cast_.approach(robot_of_[static_cast<size_t>(m)]));
}

Outcome Planner::outcome() { return {motions_, cast_.refused(), statistics_}; }

// The last resort: everything that should have moved is named, nothing moves.
Outcome Planner::nobody_moves() {
    Outcome out{{}, cast_.refused(), statistics_};
    for (int i = 0; i < cast_.size(); ++i) {
        out.motions.push_back({{0.0}, {task_.start[static_cast<size_t>(i)]}});
        const bool named = std::any_of(out.refused.begin(), out.refused.end(),
                                       [&](const Refused &r) { return r.robot == i; });
        if (cast_.acts(i) && !cast_.still(i) && !named) out.refused.push_back({i, Refusal::no_way, -1});
    }
    return out;
}

} // namespace

const char *to_string(Refusal reason) {
    switch (reason) {
    case Refusal::goal_beyond_travel:
        return "its goal with the approach lies beyond the travel of its axes";
    case Refusal::goal_blocked:
        return "its goal touches something that does not move";
    case Refusal::goal_taken:
        return "its goal touches the goal of another positioner";
    case Refusal::no_way_alone:
        return "it cannot pass what stands still around it, even alone";
    case Refusal::no_way:
        return "no way past its neighbours was found";
    case Refusal::start_blocked:
        return "it touches something before it moves";
    }
    return "";
}

Outcome plan(const Bodies &bodies, const Task &task, const Settings &settings) {
    return Planner(bodies, task, settings).run();
}

} // namespace fl::planning
