// Grids that are finer only where the way past what does not move is narrow: on one that is finer everywhere
// an axis moves at a part of its speed.
#include "goals/goal_feasibility.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

constexpr int steps_around[] = {1, 3}; // of the wide grid, that are finer on both sides of where it is narrow

// The line next to an angle.
int line_at(const AxisGrid &grid, double angle_rad) {
    int line = 0;
    while (line + 1 < grid.size() &&
           std::abs(grid.angle(line + 1) - angle_rad) <= std::abs(grid.angle(line) - angle_rad))
        ++line;
    return line;
}

FineLines widened(FineLines fine, double by_rad) {
    return {fine.parts, fine.low_rad - by_rad, fine.high_rad + by_rad};
}

// A line at the end of the travel, if the range reaches it, and hardly more.
FineLines low_end(FineLines fine) { return {fine.parts, fine.low_rad, fine.low_rad}; }
FineLines high_end(FineLines fine) { return {fine.parts, fine.high_rad, fine.high_rad}; }

} // namespace

// Of a way on a finer grid, the part to which the wide one leads neither from the start nor from the goal.
// @pre the way is not empty.
GoalFeasibility::FineAxes GoalFeasibility::narrow_part(const List<Cell> &way, const Robot &fine, Robot &wide,
                                                       int parts) {
    const auto reached = [&](int k, const List<int> &steps) {
        const Cell next{line_at(wide.alpha(), fine.alpha().angle(way[k].alpha)),
                        line_at(wide.beta(), fine.beta().angle(way[k].beta))};
        return steps[wide.index(next)] >= 0;
    };
    int begin = 0, end = way.size() - 1;
    while (begin + 1 < way.size() && reached(begin + 1, wide.steps_from_start())) ++begin;
    while (end > 0 && reached(end - 1, wide.steps_from_goal())) --end;
    if (begin > end) std::swap(begin, end);
    FineLines alpha{parts, fine.alpha().angle(way[begin].alpha), fine.alpha().angle(way[begin].alpha)};
    FineLines beta{parts, fine.beta().angle(way[begin].beta), fine.beta().angle(way[begin].beta)};
    for (int k = begin; k <= end; ++k) {
        const Angles at{fine.alpha().angle(way[k].alpha), fine.beta().angle(way[k].beta)};
        alpha = {parts, std::min(alpha.low_rad, at.alpha_rad), std::max(alpha.high_rad, at.alpha_rad)};
        beta = {parts, std::min(beta.low_rad, at.beta_rad), std::max(beta.high_rad, at.beta_rad)};
    }
    return {alpha, beta};
}

// Keeps it if the way takes fewer steps.
void GoalFeasibility::try_fine(PositionerIndex i, const FineAxes &fine) {
    Goal &goal = goals_[i];
    const FineAxes before = std::exchange(goal.fine, fine);
    const int finer = std::exchange(goal.finer, 1);
    const int steps = make_robot(i).steps_alone();
    if (steps >= 0 && steps < goal.steps_alone) {
        goal.steps_alone = steps;
        return;
    }
    goal.fine = before;
    goal.finer = finer;
}

void GoalFeasibility::hasten(PositionerIndex i) {
    Goal &goal = goals_[i];
    if (goal.finer == 1 || std::exchange(goal.hastened, true)) return;
    const int parts = goal.finer;
    Robot fine = make_robot(i);
    goal.finer = 1;
    Robot wide = make_robot(i);
    const double step = step_rad(i);
    goal.finer = parts;
    const List<Cell> way = fine.way_alone();
    if (way.empty()) return;
    const auto [alpha, beta] = narrow_part(way, fine, wide, parts);
    try_fine(i, {low_end(alpha), low_end(beta)});
    try_fine(i, {high_end(alpha), high_end(beta)});
    for (const int around : steps_around) {
        const FineLines wide_alpha = widened(alpha, around * step), wide_beta = widened(beta, around * step);
        try_fine(i, {wide_alpha, wide_beta});
        try_fine(i, {wide_alpha, {}});
        try_fine(i, {{}, wide_beta});
    }
}

} // namespace fl::planning
