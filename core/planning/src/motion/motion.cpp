#include "motion/motion.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

// Keeps speed and acceleration below the limits when positions are rounded on the bus (3e-7 deg).
constexpr double within = 1.0 - 1e-6;

void add_point(Motion &motion, double time_s, Angles angles) {
    motion.time_s.push_back(time_s);
    motion.angles.push_back(angles);
}

bool straight(const AxisGrid &axis, int line, VelocityChange change) {
    const double before = axis.angle(line) - axis.angle(line + change.from),
                 after = axis.angle(line + change.to) - axis.angle(line);
    return std::abs(after - before) < 1e-12;
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

} // namespace

Clock::Clock(const Settings &s, const Task &task)
    : Clock(s, task.approach_rad.empty()
                   ? 0.0
                   : *std::max_element(task.approach_rad.begin(), task.approach_rad.end())) {}

Clock::Clock(const Settings &s, double highest_approach_rad) {
    const double step_s =
        std::max(s.grid_rad / s.speed_rad_s, std::sqrt(2.0 * s.grid_rad / s.acceleration_rad_s2));
    const double ticks = std::ceil(step_s / (quarters * s.tick_s) - 1e-6);
    quarter_s = ticks * s.tick_s;
    grid_rad = within * std::min({s.grid_rad, s.speed_rad_s * this->step_s(),
                                  0.5 * s.acceleration_rad_s2 * this->step_s() * this->step_s()});
    // thirds of the approach cover 1/4, 1/2, 1/4 of it
    const double by_speed = 0.5 * highest_approach_rad / (within * s.speed_rad_s * quarter_s);
    const double by_acceleration =
        std::sqrt(0.25 * highest_approach_rad / (within * s.acceleration_rad_s2)) / quarter_s;
    leg_quarters = std::max(1, static_cast<int>(std::ceil(std::max(by_speed, by_acceleration))));
}

Motion motion_of(const Robot &robot, const List<Cell> &path, int steps, const Clock &clock,
                 double approach_rad) {
    Motion motion;
    add_point(motion, 0.0, angles_at(robot, path[0], {}, 2));
    for (int step = 0; step <= steps; ++step) {
        const Cell here = cell_at(path, step);
        const VelocityChanges changes = changes_at(path, step);
        if (straight(robot.alpha(), here.alpha, changes.alpha) &&
            straight(robot.beta(), here.beta, changes.beta))
            continue;
        for (int k = step == 0 ? 2 : 1; k <= 3; ++k) // the first point is there already
            add_point(motion, (4 * step + k - 1) * clock.quarter_s, angles_at(robot, here, changes, k));
    }
    const int end = 4 * steps + 2; // in quarters: the last cut corner ends here
    const Angles high = angles_at(robot, cell_at(path, steps), {}, 2);
    if (motion.time_s.back() < end * clock.quarter_s) add_point(motion, end * clock.quarter_s, high);
    if (approach_rad == 0.0) return motion;
    const double down[] = {0.25, 0.75, 1.0};
    for (int k = 0; k < 3; ++k)
        add_point(motion, (end + (k + 1) * clock.leg_quarters) * clock.quarter_s,
                  {high.alpha_rad - down[k] * approach_rad, high.beta_rad - down[k] * approach_rad});
    return motion;
}

SweptArm approach_leg(const ArmBody &body, Angles goal, double approach_rad) {
    SweptArm leg;
    for (int k = 0; k <= quarters; ++k) {
        const double above = approach_rad * (quarters - k) / quarters;
        leg.at[k] = body.line(turn(goal.alpha_rad + above + body.arm.alpha_off_rad),
                              turn(goal.beta_rad + above + body.arm.beta_off_rad));
    }
    const double part = approach_rad / quarters;
    leg.bulge_mm = (std::abs(body.arm.l_alpha_mm) + 4.0 * body.far_mm()) * part * part / 8.0;
    measure_displacement_bound(leg);
    return leg;
}

} // namespace fl::planning
