#include "grid.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

// A remainder of the travel narrower than this part of a step gets no line of its own.
constexpr double narrow = 0.25;

void add_outside(std::vector<double> &lines, double from, double step, double end) {
    const double way = std::abs(end - from), side = end < from ? -1.0 : 1.0;
    if (side * (end - from) <= 0.0) return;
    const int n = static_cast<int>(std::floor(way / step));
    for (int i = 1; i <= n; ++i) lines.push_back(from + side * i * step);
    if (way - n * step > narrow * step) lines.push_back(end);
}

int find(const std::vector<double> &lines, double value) {
    return static_cast<int>(std::lower_bound(lines.begin(), lines.end(), value) - lines.begin());
}

} // namespace

AxisGrid::AxisGrid(double start_rad, double goal_rad, double step_rad, double low_rad, double high_rad,
                   double zero_rad) {
    const double way = goal_rad - start_rad;
    const int between = static_cast<int>(std::ceil(std::abs(way) / step_rad - 1e-9));
    lines_.push_back(start_rad);
    for (int i = 1; i < between; ++i) lines_.push_back(start_rad + way * i / between);
    if (way != 0.0) lines_.push_back(goal_rad);
    add_outside(lines_, std::min(start_rad, goal_rad), step_rad,
                std::min(low_rad, std::min(start_rad, goal_rad)));
    add_outside(lines_, std::max(start_rad, goal_rad), step_rad,
                std::max(high_rad, std::max(start_rad, goal_rad)));
    std::sort(lines_.begin(), lines_.end());
    start_ = find(lines_, start_rad);
    goal_ = find(lines_, goal_rad);

    turns_.resize(lines_.size() * slots);
    for (int line = 0; line < size(); ++line)
        for (size_t s = 0; s < slots; ++s)
            turns_[static_cast<size_t>(line) * slots + s] =
                fl::planning::turn(slot_angle(line, s) + zero_rad);
}

double AxisGrid::slot_angle(int line, size_t slot) const {
    const double here = angle(line);
    const double below = angle(std::max(line - 1, 0)) - here,
                 above = angle(std::min(line + 1, size() - 1)) - here;
    switch (slot) {
    case 1:
        return here + 0.5 * below;
    case 2:
        return here + 0.5 * above;
    case 3:
        return here + 0.25 * below;
    case 4:
        return here + 0.25 * above;
    case 5:
        return here + below / 16.0;
    case 6:
        return here + above / 16.0;
    case 7:
        return here + (below + above) / 16.0;
    default:
        return here;
    }
}

double AxisGrid::angle(int line, Bend bend, int k) const { return slot_angle(line, slot(bend, k)); }

} // namespace fl::planning
