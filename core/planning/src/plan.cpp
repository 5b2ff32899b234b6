#include "fiberloom/planning.hpp"
#include "goals/goal_feasibility.hpp"
#include "motion/motion.hpp"
#include "points/by_quarters.hpp"
#include "points/early_descents.hpp"
#include "points/fewer_points.hpp"
#include "search/repair.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

namespace fl::planning {
namespace {

constexpr int give_up_rounds = 40;
constexpr int refining_rounds = 4; // the first ones, in which knots get finer grids

// What a round may take; the last one stands for all that follow it. What resists a whole round seldom comes
// undone, and what resists the next one too hardly ever. There grids are finer, and a knot that begins anew
// takes long and was of no use.
struct RoundEffort {
    double share;    // of the settings' effort
    int begins_anew; // so often the knot of a pair that resists grows and begins anew in vain
};
constexpr RoundEffort round_efforts[] = {{1.0, 1}, {0.4, 1}, {0.1, 0}};

const RoundEffort &effort_of(int round) {
    return round_efforts[std::min(round, static_cast<int>(std::size(round_efforts)) - 1)];
}

constexpr double late_return = 1.3; // of the steps that the longest path needs

int last_arrival(const PathSet &paths) {
    int last = 0;
    for (const PathIndex m : paths.places()) last = std::max(last, paths.arrival(m));
    return last;
}

// begin: the quarter in which the first turn begins.
LastLeg last_leg(const AxisDescent &axis, const Clock &clock, int begin) {
    return {axis.height_rad, turn_begins_s(clock, begin, axis.turn),
            turn_begins_s(clock, begin, axis.turn + 1)};
}

Approach approach_of(PositionerIndex i, const Descent &descent, const Clock &clock, int begin) {
    return {i.value(), last_leg(descent.alpha, clock, begin), last_leg(descent.beta, clock, begin)};
}

// The facade's work: settle the goals, find paths for all, give up those for which there is none.
class Planner {
  public:
    Planner(const Bodies &bodies, const Task &task, const Settings &settings)
        : settings_(settings), task_(task), clock_(settings, task), goals_(bodies, task, settings, clock_) {}

    // None if a positioner would have to be given up that may have a way if none of them is ever late.
    std::optional<PlanResult> run() {
        goals_.settle();
        while (round_ < give_up_rounds && !too_much_asked_)
            if (find_paths()) return PlanResult{motions_, goals_.refused(), statistics_, approaches_};
        if (too_much_asked_) return std::nullopt;
        return none_moves();
    }
    std::int64_t expansions() const { return statistics_.expansions; }

  private:
    void settle();
    PathSet assemble();
    int late_steps() const;
    void spare(PathSet &paths) const;
    void note_spared(const PathSet &paths);
    bool find_paths();
    void keep_ways(PathSet &&paths);
    void take_over(PathSet &paths) const;
    bool refine(PositionerIndex i, PositionerIndex j);
    bool clear_the_way(const PathSet &paths);
    bool spend(const PathSet &paths);
    void give_up(const PathSet &paths);
    bool send_elsewhere(const PathSet &paths);
    void give_up_some(const PathSet &paths);
    void give_up_locked(const PathSet &paths, const List<Repair::Pair> &pairs);
    bool lock_each_other(PositionerIndex i, PositionerIndex j);
    void keep(PathSet &paths);
    List<int, PathIndex> begins_of_descents(PathSet &paths, const List<OwnKnots, PathIndex> &own,
                                            int end) const;
    int last_step(const PathSet &paths) const;
    PlanResult none_moves();

    const Settings &settings_;
    const Task &task_;
    Clock clock_;
    GoalFeasibility goals_;
    List<PositionerIndex, PathIndex> positioner_of_;
    std::optional<PathSet> before_;                      // of a round before ...
    List<PositionerIndex, PathIndex> positioner_before_; // ... and whose its paths are
    std::vector<Motion> motions_;
    std::vector<Approach> approaches_;
    Statistics statistics_;
    int least_steps_ = 0; // that the longest path needs past what is at rest
    List<std::pair<PositionerIndex, PositionerIndex>> spared_; // not planned with lateness, the lower first
    bool too_much_asked_ = false;
    bool trial_ = false; // the round has grids that are finer at their ends: where it fails the next one
                         // begins as if it had not been
    List<std::pair<PositionerIndex, PositionerIndex>> not_locked_; // as their goals are
    // What all went to when one that does not arrive came back to its start, until it is known whether it is
    // better elsewhere. That is tried once.
    struct BeforeElsewhere {
        GoalFeasibility::State goals;
        int arrival = 0;
    };
    std::optional<BeforeElsewhere> before_elsewhere_;
    bool sent_elsewhere_ = false;
    int round_ = 0;
};

// Some goals have changed: what is known of locks is as they were.
void Planner::settle() {
    goals_.settle();
    not_locked_.clear();
}

PathSet Planner::assemble() {
    positioner_of_.clear();
    int bound = 0, alone = 0;
    List<Robot> robots;
    for (const PositionerIndex i : goals_.places()) {
        if (!goals_.moves(i)) continue;
        positioner_of_.push_back(i);
        if (!goals_.still(i)) goals_.hasten(i);
        robots.push_back(goals_.make_robot(i));
        if (goals_.still(i)) continue;
        bound = std::max(bound, robots.back().travel_steps());
        alone = std::max(alone, goals_.steps_alone(i));
    }
    const int steps = std::max(static_cast<int>(std::ceil(bound * settings_.first_deadline)), alone);
    statistics_.bound_steps = bound;
    least_steps_ = std::max(bound, alone);
    PathSet paths(goals_.need_mm(), steps, late_steps());
    for (Robot &robot : robots) paths.add(std::move(robot));
    for (const PathIndex m : paths.places()) paths.at(m).still = goals_.still(positioner_of_[m]);
    paths.find_neighbours();
    spare(paths);
    return paths;
}

int Planner::late_steps() const {
    return static_cast<int>(
        std::min(std::ceil(settings_.late_s / clock_.step_s() - 1e-9), 1.0 * most_late_steps));
}

// As in the round before, and those for which there is no hope.
void Planner::spare(PathSet &paths) const {
    if (late_steps() == 0) return;
    List<PathIndex, PositionerIndex> place(goals_.places().end().place, PathIndex());
    for (const PathIndex m : paths.places()) place[positioner_of_[m]] = m;
    for (const auto &[i, j] : spared_)
        if (place[i] != PathIndex() && place[j] != PathIndex()) paths.spare(place[i], place[j]);
    paths.spare_hopeless();
}

void Planner::note_spared(const PathSet &paths) {
    statistics_.late = late_steps() > 0;
    spared_.clear();
    for (const PathIndex m : paths.places())
        for (const PathIndex n : paths.at(m).spared)
            if (positioner_of_[m] < positioner_of_[n])
                spared_.emplace_back(positioner_of_[m], positioner_of_[n]);
    std::sort(spared_.begin(), spared_.end());
    statistics_.not_late.clear();
    for (const auto &[i, j] : spared_) statistics_.not_late.push_back({i.value(), j.value()});
}

// For the rounds to come.
void Planner::keep_ways(PathSet &&paths) {
    paths.free_rooms();
    before_ = std::move(paths);
    positioner_before_ = positioner_of_;
}

// The ways of those that go from and to the same places as in the round before.
void Planner::take_over(PathSet &paths) const {
    if (!before_) return;
    List<PathIndex, PositionerIndex> place(goals_.places().end().place, PathIndex());
    for (const PathIndex m : before_->places()) place[positioner_before_[m]] = m;
    for (const PathIndex m : paths.places())
        if (const PathIndex old = place[positioner_of_[m]]; old != PathIndex())
            paths.take_over(m, before_->at(old));
}

bool Planner::find_paths() {
    PathSet paths = assemble();
    const int wanted = paths.steps();
    const int last = static_cast<int>(settings_.last_deadline * wanted) + 20;
    take_over(paths);
    const RoundEffort &effort = effort_of(round_);
    Repair repair(paths, settings_, statistics_,
                  {effort.share, effort.begins_anew, [&](PathIndex m, PathIndex n) {
                       return lock_each_other(positioner_of_[m], positioner_of_[n]);
                   }});
    const List<PathIndex> without = repair.first_paths();
    for (const PathIndex m : without) goals_.has_no_way(positioner_of_[m]);
    if (!without.empty()) {
        statistics_.expansions += repair.expansions();
        settle();
        ++round_;
        if (!std::exchange(trial_, false)) keep_ways(std::move(paths));
        return false;
    }
    const bool free = repair.run(wanted, last);
    if (const auto before = std::exchange(before_elsewhere_, std::nullopt))
        if (!free || last_arrival(paths) > before->arrival) {
            goals_.go_back_to(before->goals);
            not_locked_.clear();
            return false; // its ways are kept
        }
    if (free && send_elsewhere(paths)) {
        keep_ways(std::move(paths));
        return false;
    }
    if (free) repair.hurry(least_steps_);
    if (free) repair.tidy();
    statistics_.expansions += repair.expansions();
    note_spared(paths);
    if (free) {
        keep(paths);
    } else {
        const bool trial = std::exchange(trial_, false);
        if (!repair.locked().empty()) {
            give_up_locked(paths, repair.locked());
        } else {
            ++round_;
            if (!clear_the_way(paths) && !spend(paths)) give_up(paths);
        }
        if (!trial) keep_ways(std::move(paths));
    }
    return free;
}

// Those that do not arrive, but have to leave their start for others and come back to it far too late.
bool Planner::send_elsewhere(const PathSet &paths) {
    if (std::exchange(sent_elsewhere_, true) || statistics_.cut_short) return false;
    const BeforeElsewhere before{goals_.state(), last_arrival(paths)};
    bool any = false;
    for (const PathIndex m : paths.places())
        if (paths.arrival(m) > late_return * least_steps_) any |= goals_.go_elsewhere(positioner_of_[m]);
    if (!any) return false;
    before_elsewhere_ = before;
    settle();
    return true;
}

// Whether two that conflict shall be tried on finer grids: slower, but they may pass where wide steps cannot.
bool Planner::refine(PositionerIndex i, PositionerIndex j) {
    if (round_ >= refining_rounds || statistics_.cut_short || goals_.still(i) || goals_.still(j))
        return false;
    const bool first = goals_.refine(i), second = goals_.refine(j);
    trial_ |= goals_.finer_at_ends(i) || goals_.finer_at_ends(j);
    return first || second;
}

// Those that do not arrive, but would leave their start and come back to it, and still conflict go to another
// place: before another loses its goal for one that has lost its own. Whether there are any.
bool Planner::clear_the_way(const PathSet &paths) {
    if (statistics_.cut_short) return false;
    bool any = false;
    for (const PathIndex m : paths.places())
        if (!paths.at(m).conflicts.empty()) any |= goals_.go_elsewhere(positioner_of_[m]);
    if (any) settle();
    return any;
}

// Where pairs still conflict, they and those around them try it with nothing in hand; false: they have.
bool Planner::spend(const PathSet &paths) {
    List<PositionerIndex> tangled;
    for (const PathIndex m : paths.places())
        if (!paths.at(m).conflicts.empty()) tangled.push_back(positioner_of_[m]);
    return goals_.spend(tangled);
}

void Planner::give_up(const PathSet &paths) {
    too_much_asked_ = late_steps() > 0 && !statistics_.cut_short;
    if (!too_much_asked_) give_up_some(paths);
}

// One of each pair that still conflicts; those with more conflicts first.
void Planner::give_up_some(const PathSet &paths) {
    List<std::pair<int, PathIndex>> order; // fewer conflicts come last
    for (const PathIndex m : paths.places())
        if (!paths.at(m).conflicts.empty()) order.emplace_back(-paths.at(m).conflicts.size(), m);
    std::sort(order.begin(), order.end());
    List<PathIndex> gone;
    for (const auto &[conflicts, m] : order) {
        const auto &theirs = paths.at(m).conflicts;
        const auto open = std::find_if(theirs.begin(), theirs.end(), [&](const PathConflict &conflict) {
            return !gone.contains(conflict.other);
        });
        if (open == theirs.end()) continue;
        gone.push_back(m);
        if (refine(positioner_of_[m], positioner_of_[open->other])) continue;
        goals_.give_up_one(positioner_of_[m], positioner_of_[open->other], Refusal::no_way);
    }
    settle();
}

bool Planner::lock_each_other(PositionerIndex i, PositionerIndex j) {
    if (not_locked_.contains({i, j})) return false;
    if (goals_.lock_each_other(i, j)) return true;
    not_locked_.emplace_back(i, j);
    return false;
}

// One of each pair of which the two lock each other. That is proven, so the round does not count as one in
// vain.
void Planner::give_up_locked(const PathSet &paths, const List<Repair::Pair> &pairs) {
    List<PathIndex> gone;
    for (const auto &[first, second] : pairs) {
        if (gone.contains(first) || gone.contains(second)) continue;
        const bool fewer = paths.at(first).conflicts.size() < paths.at(second).conflicts.size();
        const auto [one, other] = fewer ? std::pair(second, first) : std::pair(first, second);
        gone.push_back(one);
        goals_.give_up_one(positioner_of_[one], positioner_of_[other], Refusal::locked);
    }
    settle();
}

// The last step in which any positioner moves.
int Planner::last_step(const PathSet &paths) const {
    int last = 0;
    for (const PathIndex m : paths.places())
        for (int step = last + 1; step <= paths.steps(); ++step)
            if (!(paths.at(m).path[step] == paths.at(m).path[step - 1])) last = step;
    return last;
}

// Where any may be late all come down together: those on their way are then seen as far as they are.
List<int, PathIndex> Planner::begins_of_descents(PathSet &paths, const List<OwnKnots, PathIndex> &own,
                                                 int end) const {
    if (paths.heeds_lateness() || settings_.enough()) return List<int, PathIndex>(paths.size(), end);
    List<WayDown, PathIndex> ways;
    for (const PathIndex m : paths.places()) {
        const PositionerIndex i = positioner_of_[m];
        ways.push_back({goals_.descent(i), goals_.legs(i)});
    }
    return early_descents(paths, own, ways, {end, clock_.turn_quarters}, goals_.need_mm());
}

void Planner::keep(PathSet &paths) {
    const int last = end_of_path(last_step(paths));
    auto [earlier, own] = earlier_by_quarters(paths, settings_.enough);
    fewer_points(paths, settings_.most_points, settings_.enough, own);
    const int end = last - earlier;
    statistics_.quarters_earlier = earlier;
    statistics_.steps = static_cast<double>(end - end_of_path(0)) / quarters;
    statistics_.step_s = clock_.step_s();
    const List<int, PathIndex> begins = begins_of_descents(paths, own, end);
    List<Motion, PositionerIndex> motions;
    for (const Angles &start : task_.start) motions.push_back({{0.0}, {start}});
    for (const PathIndex m : paths.places()) {
        const PositionerIndex i = positioner_of_[m];
        if (paths.at(m).still) continue;
        const Descent &descent = goals_.descent(i);
        motions[i] = own[m].empty() ? motion_of(paths.at(m).robot, paths.at(m).path, clock_)
                                    : motion_along(own[m], clock_.quarter_s);
        add_descent(motions[i], descent, clock_, begins[m]);
        if (goals_.descends_otherwise(i)) approaches_.push_back(approach_of(i, descent, clock_, begins[m]));
    }
    motions_.assign(motions.begin(), motions.end());
}

// The last resort: everything that should have moved is named, nothing moves.
PlanResult Planner::none_moves() {
    PlanResult out{{}, goals_.refused(), statistics_};
    for (const PositionerIndex i : goals_.places()) {
        out.motions.push_back({{0.0}, {row(task_.start, i)}});
        const bool named = std::any_of(out.refused.begin(), out.refused.end(),
                                       [&](const Refused &r) { return r.robot == i.value(); });
        if (goals_.moves(i) && !goals_.still(i) && !named)
            out.refused.push_back({i.value(), Refusal::no_way, -1});
    }
    return out;
}

} // namespace

const char *to_string(Refusal reason) {
    switch (reason) {
    case Refusal::goal_beyond_travel:
        return "its goal lies beyond the travel of its axes{axes}";
    case Refusal::approach_beyond_travel:
        return "its goal with the shortest approach lies beyond the travel of its axes{axes}";
    case Refusal::goal_blocked:
        return "its goal touches {still}";
    case Refusal::approach_blocked:
        return "its approach touches {still}";
    case Refusal::goal_taken:
        return "its goal touches the goal of {other}";
    case Refusal::approach_at_goal:
        return "its approach touches the goal of {other}";
    case Refusal::goal_on_approach:
        return "its goal touches the approach of {other}";
    case Refusal::approach_taken:
        return "its approach touches the approach of {other}";
    case Refusal::no_way_alone:
        return "it cannot pass what stands still around it within its travel, even alone";
    case Refusal::no_way:
        return "no way past its neighbours was found";
    case Refusal::locked:
        return "it and {other} lock each other even if all others are absent: one of the two needs another "
               "target";
    case Refusal::start_blocked:
        return "it touches {other} before it moves";
    }
    return "";
}

PlanResult plan(const Bodies &bodies, const Task &task, const Settings &settings) {
    Planner planner(bodies, task, settings);
    if (std::optional<PlanResult> made = planner.run()) return *made;
    // no goal is given up for lateness
    Settings on_time = settings;
    on_time.late_s = 0.0;
    PlanResult made = *Planner(bodies, task, on_time).run();
    made.statistics.expansions += planner.expansions();
    return made;
}

} // namespace fl::planning
