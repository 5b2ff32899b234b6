#include "motion/grid.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace fl::planning {
namespace {

// A remainder of the travel narrower than this part of a step gets no line of its own.
constexpr double narrow = 0.25;

// least: of a remainder that gets a line.
void add_outside(List<double> &lines, double from, double step, double end, double least) {
    const double room = std::abs(end - from), side = end < from ? -1.0 : 1.0;
    if (side * (end - from) <= 0.0) return;
    const int n = static_cast<int>(std::floor(room / step));
    for (int i = 1; i <= n; ++i) lines.push_back(from + side * i * step);
    if (room - n * step > least) lines.push_back(end);
}

// Into how many parts what lies between two lines is cut.
int parts_of(double from, double to, const GridSpan &span, const FineLines &fine) {
    const double middle = from + 0.5 * (to - from);
    const double off = std::min(std::abs(middle - span.start_rad), std::abs(middle - span.goal_rad));
    const int where_narrow = to > fine.low_rad && from < fine.high_rad ? fine.parts : 1;
    return std::max(where_narrow, off < span.ends_rad ? span.finer_at_ends : 1);
}

// The same lines, and those that are closer together.
List<double> with_fine(const List<double> &lines, const GridSpan &span, const FineLines &fine) {
    List<double> out;
    for (int k = 0; k + 1 < lines.size(); ++k) {
        const double from = lines[k], way = lines[k + 1] - from;
        const int parts = parts_of(from, lines[k + 1], span, fine);
        for (int part = 0; part < parts; ++part) out.push_back(from + way * part / parts);
    }
    out.push_back(lines.back());
    return out;
}

int find(const List<double> &lines, double value) {
    return static_cast<int>(std::lower_bound(lines.begin(), lines.end(), value) - lines.begin());
}

} // namespace

AxisGrid::AxisGrid(const GridSpan &span, double step_rad, const FineLines &fine) {
    zero_rad_ = span.zero_rad;
    step_rad_ = step_rad;
    const double way = span.goal_rad - span.start_rad;
    const int between = static_cast<int>(std::ceil(std::abs(way) / step_rad - 1e-9));
    List<double> lines{span.start_rad};
    for (int i = 1; i < between; ++i) lines.push_back(span.start_rad + way * i / between);
    if (way != 0.0) lines.push_back(span.goal_rad);
    const double lower = std::min(span.start_rad, span.goal_rad);
    const double upper = std::max(span.start_rad, span.goal_rad);
    const double low = std::min(span.low_rad, lower), high = std::max(span.high_rad, upper);
    const double least = narrow * step_rad;
    add_outside(lines, lower, step_rad, low, fine.low_rad <= low ? least / fine.parts : least);
    add_outside(lines, upper, step_rad, high, fine.high_rad >= high ? least / fine.parts : least);
    std::sort(lines.begin(), lines.end());
    lines = with_fine(lines, span, fine);
    start_ = find(lines, span.start_rad);
    goal_ = find(lines, span.goal_rad);

    List<Turn> turns(lines.size() * slots);
    for (int line = 0; line < lines.size(); ++line)
        for (int s = 0; s < slots; ++s)
            turns[line * slots + s] = fl::planning::turn(slot_angle(lines, line, s) + span.zero_rad);
    lines_ = std::make_shared<const Lines>(Lines{std::move(lines), std::move(turns)});
}

bool AxisGrid::straight(int line, VelocityChange change) const {
    const double before = angle(line) - angle(line + change.from),
                 after = angle(line + change.to) - angle(line);
    return std::abs(after - before) < 1e-12;
}

bool AxisGrid::same_as(const AxisGrid &other) const {
    const List<double> &mine = lines_->angles_rad, &theirs = other.lines_->angles_rad;
    return start_ == other.start_ && goal_ == other.goal_ &&
           std::equal(mine.begin(), mine.end(), theirs.begin(), theirs.end());
}

double AxisGrid::slot_angle(const List<double> &lines, int line, int slot) {
    const double here = lines[line];
    const double below = lines[std::max(line - 1, 0)] - here,
                 above = lines[std::min(line + 1, lines.size() - 1)] - here;
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
        return here + below / 8.0;
    case 6:
        return here + above / 8.0;
    case 7:
        return here + (below + above) / 8.0;
    default:
        return here;
    }
}

double AxisGrid::angle(int line, VelocityChange change, int k) const {
    return slot_angle(lines_->angles_rad, line, slot(change, k));
}

} // namespace fl::planning
