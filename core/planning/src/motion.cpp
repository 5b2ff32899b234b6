#include "motion.hpp"

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

bool straight(const AxisGrid &axis, int line, Bend bend) {
    const double before = axis.angle(line) - axis.angle(line + bend.from),
                 after = axis.angle(line + bend.to) - axis.angle(line);
    return std::abs(after - before) < 1e-12;
}

Angles angles_at(const Robot &robot, Cell c, Bends bends, int k) {
    return {robot.alpha().angle(c.alpha, bends.alpha, k), robot.beta().angle(c.beta, bends.beta, k)};
}

Cell cell_at(const std::vector<Cell> &way, int step) {
    return way[static_cast<size_t>(std::clamp(step, 0, static_cast<int>(way.size()) - 1))];
}

Bends bends_at(const std::vector<Cell> &way, int step) {
    const Cell before = cell_at(way, step - 1), here = cell_at(way, step), after = cell_at(way, step + 1);
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

Motion motion_of(const Robot &robot, const std::vector<Cell> &way, int steps, const Clock &clock,
                 double approach_rad) {
    Motion motion;
    add_point(motion, 0.0, angles_at(robot, way[0], {}, 2));
    for (int step = 0; step <= steps; ++step) {
        const Cell here = cell_at(way, step);
        const Bends bends = bends_at(way, step);
        if (straight(robot.alpha(), here.alpha, bends.alpha) && straight(robot.beta(), here.beta, bends.beta))
            continue;
        for (int k = step == 0 ? 2 : 1; k <= 3; ++k) // the first point is there already
            add_point(motion, (4 * step + k - 1) * clock.quarter_s, angles_at(robot, here, bends, k));
    }
    const int end = 4 * steps + 2; // in quarters: the last cut corner ends here
    const Angles high = angles_at(robot, cell_at(way, steps), {}, 2);
    if (motion.time_s.back() < end * clock.quarter_s) add_point(motion, end * clock.quarter_s, high);
    if (approach_rad == 0.0) return motion;
    const double down[] = {0.25, 0.75, 1.0};
    for (int k = 0; k < 3; ++k)
        add_point(motion, (end + (k + 1) * clock.leg_quarters) * clock.quarter_s,
                  {high.alpha_rad - down[k] * approach_rad, high.beta_rad - down[k] * approach_rad});
    return motion;
}

Piece approach_leg(const Arm &arm, double from_mm, double to_mm, Angles goal, double approach_rad) {
    Piece piece;
    for (int k = 0; k <= quarters; ++k) {
        const double above = approach_rad * (quarters - k) / quarters;
        const Turn a = turn(goal.alpha_rad + above + arm.alpha_off_rad);
        const Turn u = a * turn(goal.beta_rad + above + arm.beta_off_rad);
        const Vec2 e{arm.centre_mm.x + arm.l_alpha_mm * a.c, arm.centre_mm.y + arm.l_alpha_mm * a.s};
        piece.at[static_cast<size_t>(k)] = {{e.x + from_mm * u.c, e.y + from_mm * u.s},
                                            {e.x + to_mm * u.c, e.y + to_mm * u.s}};
    }
    const double far = std::max(std::abs(from_mm), std::abs(to_mm)), part = approach_rad / quarters;
    piece.bulge_mm = (std::abs(arm.l_alpha_mm) + 4.0 * far) * part * part / 8.0;
    measure_sway(piece);
    return piece;
}

} // namespace fl::planning
