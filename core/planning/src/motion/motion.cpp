#include "motion/motion.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

// Keeps speed and acceleration below the limits when positions are rounded on the bus (3e-7 deg).
constexpr double within = 1.0 - 1e-6;

// The slowest positioner takes so many steps for a way that the widest grid has one for.
constexpr double slow_steps = 4.0;

void add_point(Motion &motion, double time_s, Angles angles) {
    motion.time_s.push_back(time_s);
    motion.angles.push_back(angles);
}

Angles angles_at(const Robot &robot, Cell c, VelocityChanges changes, int k) {
    return {robot.alpha().angle(c.alpha, changes.alpha, k), robot.beta().angle(c.beta, changes.beta, k)};
}

Cell cell_at(const List<Cell> &path, int step) { return path[std::clamp(step, 0, path.size() - 1)]; }

VelocityChanges changes_at(const List<Cell> &path, int step) {
    const Cell before = cell_at(path, step - 1), here = cell_at(path, step), after = cell_at(path, step + 1);
    return {{before.alpha - here.alpha, after.alpha - here.alpha},
            {before.beta - here.beta, after.beta - here.beta}};
}

// In which an axis can go so far and stop.
double shortest_step_s(double way_rad, Pace pace) {
    return std::max(way_rad / pace.speed_rad_s, std::sqrt(2.0 * way_rad / pace.acceleration_rad_s2));
}

// A third of the speed and less, so that an axis that comes up does not turn back at full speed; then the
// last corner of a path takes half of the acceleration, and leaves this more than the approach takes.
int least_turn_quarters(double height_rad, Pace pace, double quarter_s) {
    const double by_speed = 3.0 * height_rad / (within * pace.speed_rad_s * quarter_s);
    const double by_acceleration =
        std::sqrt(2.0 * height_rad / (within * pace.acceleration_rad_s2)) / quarter_s;
    return static_cast<int>(std::ceil(std::max(by_speed, by_acceleration)));
}

} // namespace

Pace pace_of(const Settings &s, const Task &task, int robot) {
    const auto k = static_cast<size_t>(robot);
    return {task.speed_rad_s.empty() ? s.speed_rad_s : task.speed_rad_s[k],
            task.acceleration_rad_s2.empty() ? s.acceleration_rad_s2 : task.acceleration_rad_s2[k]};
}

Clock::Clock(const Settings &s, const Task &task) : widest_rad(s.grid_rad) {
    List<Pace> paces;
    List<double> heights;
    for (size_t k = 0; k < task.fixed.size(); ++k)
        if (task.fixed[k] == 0) {
            paces.push_back(pace_of(s, task, static_cast<int>(k)));
            heights.push_back(task.approach_rad[k]);
        }
    if (paces.empty()) paces.push_back({s.speed_rad_s, s.acceleration_rad_s2});
    heights.resize(paces.size());
    double fastest_s = shortest_step_s(s.grid_rad, paces.front()), slowest_s = 0.0;
    for (const Pace &pace : paces) {
        fastest_s = std::min(fastest_s, shortest_step_s(s.grid_rad, pace));
        slowest_s = std::max(slowest_s, shortest_step_s(s.grid_rad / slow_steps, pace));
    }
    const double ticks = std::ceil(std::max(fastest_s, slowest_s) / (quarters * s.tick_s) - 1e-6);
    quarter_s = ticks * s.tick_s;
    turn_quarters = 2;
    for (int k = 0; k < paces.size(); ++k)
        turn_quarters = std::max(turn_quarters, least_turn_quarters(heights[k], paces[k], quarter_s));
}

double Clock::grid_rad(Pace pace) const {
    return within * std::min({widest_rad, pace.speed_rad_s * step_s(),
                              0.5 * pace.acceleration_rad_s2 * step_s() * step_s()});
}

double turn_begins_s(const Clock &clock, int begin, int turn) {
    return (begin + turn * clock.turn_quarters) * clock.quarter_s;
}

// An axis that goes up in one turn and down in the next changes its speed by two heights a turn.
double Clock::highest_hook_rad(double acceleration_rad_s2) const {
    const double turn_s = turn_quarters * quarter_s;
    return 0.5 * within * acceleration_rad_s2 * turn_s * turn_s;
}

void add_descent(Motion &motion, const Descent &descent, const Clock &clock, int begin) {
    const Angles end = motion.angles.back(), highest = descent.above(0);
    const Angles goal{end.alpha_rad - highest.alpha_rad, end.beta_rad - highest.beta_rad};
    const auto add = [&](int turn) {
        const double time_s = turn_begins_s(clock, begin, turn);
        const Angles above = descent.above(turn);
        if (motion.time_s.back() < time_s)
            add_point(motion, time_s, {goal.alpha_rad + above.alpha_rad, goal.beta_rad + above.beta_rad});
    };
    add(0);
    for (int turn = 0; turn <= descent.last_turn(); ++turn) {
        if (!descent.moves(turn)) continue;
        add(turn);
        add(turn + 1);
    }
}

Motion motion_of(const Robot &robot, const List<Cell> &path, const Clock &clock) {
    Motion motion;
    add_point(motion, 0.0, angles_at(robot, path[0], {}, 2));
    for (int step = 0; step < path.size(); ++step) {
        const Cell here = cell_at(path, step);
        const VelocityChanges changes = changes_at(path, step);
        if (robot.alpha().straight(here.alpha, changes.alpha) &&
            robot.beta().straight(here.beta, changes.beta))
            continue;
        for (int k : {1, 3})
            if (step > 0 || k > 1) // the first point is there already
                add_point(motion, (4 * step + k - 1) * clock.quarter_s, angles_at(robot, here, changes, k));
    }
    return motion;
}

} // namespace fl::planning
