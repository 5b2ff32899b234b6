#include "points/axis_by_quarters.hpp"

#include <cmath>

namespace fl::planning {
namespace {

// Between a move and the next one, in quarters of the raw motion. At each end of a cut corner, two quarters
// long, the speed changes by half of a move's; within a quarter that is all that the acceleration allows. So
// before a reversal what is sent rests for a quarter. In other cases the two corners may meet, but not
// overlap. Where an axis goes on as fast as before nothing is needed: what is left of the rest is a slower
// part, and then none.
constexpr int rest_of_reversal = 3, rest_of_corners = 2;

constexpr double same_rad = 1e-12;

} // namespace

AxisByQuarters::AxisByQuarters(const AxisGrid &grid, const List<Cell> &path, int Cell::*axis) : grid_(&grid) {
    raw_rad_.push_back(grid.angle(path[0].*axis));
    for (int step = 0; step < path.size(); ++step) {
        const double here = grid.angle(path[step].*axis),
                     next = grid.angle(path[std::min(step + 1, path.size() - 1)].*axis);
        for (int k = 0; k < quarters; ++k)
            raw_rad_.push_back(here + (next - here) * (static_cast<double>(k) / quarters));
    }
    find_moves();
}

void AxisByQuarters::find_moves() {
    for (int quarter = 0; quarter + 1 < raw_rad_.size(); ++quarter) {
        if (rests_at(quarter)) continue;
        const bool goes_on = !moves_.empty() && moves_.back().end == quarter;
        if (goes_on)
            moves_.back().end = quarter + 1;
        else
            moves_.push_back(
                {quarter, quarter + 1, moves_.empty() ? 0 : least_rest(moves_.back().end, quarter)});
    }
}

int AxisByQuarters::least_rest(int end, int begin) const {
    const double before = raw(end) - raw(end - 1), after = raw(begin + 1) - raw(begin);
    if (before * after < 0.0) return rest_of_reversal;
    return std::abs(before - after) < same_rad ? 0 : rest_of_corners;
}

// Where a rest of one quarter is left, straight from the quarter before it to the one after it.
double AxisByQuarters::sent(int quarter) const {
    for (const int first : {quarter - 1, quarter})
        if (short_rest_at(first)) {
            const double from = raw(first - 1), to = raw(first + 2);
            return from + (to - from) * ((quarter - first + 1) / 3.0);
        }
    return 0.5 * (raw(quarter - 1) + raw(quarter + 1));
}

int AxisByQuarters::nearest(int quarter) const {
    const double angle_rad = raw(quarter);
    int low = 0, high = grid_->size() - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        (grid_->angle(middle) <= angle_rad ? low : high) = middle;
    }
    return angle_rad - grid_->angle(low) <= grid_->angle(high) - angle_rad ? low : high;
}

Knots AxisByQuarters::knots() const {
    Knots out{{0, sent(0)}};
    for (int quarter = 1; quarter <= end() + 1; ++quarter)
        if (!steady(quarter)) out.push_back({quarter, sent(quarter)});
    return out;
}

std::optional<AxisByQuarters::First> AxisByQuarters::first_to_pull(int move, Spare spare) const {
    for (int k = move; k >= 0; --k) {
        if (k < move && moves_[k].pulled) return First{k + 1};
        const bool rests = rest_before(k) > moves_[k].least_rest;
        if (rests && spare != Spare::slower_first) return First{k};
        if (spare != Spare::rests && slower_stretch(k)) return First{k, true};
        if (rests) return First{k};
    }
    return std::nullopt;
}

// Of the stretch that ends there; no earlier than a quarter.
int AxisByQuarters::begin_of_stretch(int end, int first) const {
    const double speed = raw(end) - raw(end - 1);
    int begin = end - 1;
    while (begin > first && std::abs(raw(begin) - raw(begin - 1) - speed) < same_rad) --begin;
    return begin;
}

// The last one of a move that in a quarter less would be no faster than the axis can go.
std::optional<AxisByQuarters::Stretch> AxisByQuarters::slower_stretch(int move) const {
    for (int end = moves_[move].end; end > moves_[move].begin;) {
        const int begin = begin_of_stretch(end, moves_[move].begin);
        if (std::abs(raw(end) - raw(begin)) < (end - 1 - begin) * fastest_rad()) return Stretch{begin, end};
        end = begin;
    }
    return std::nullopt;
}

void AxisByQuarters::pull(int move) {
    AxisMove &m = moves_[move];
    for (int quarter = m.begin - 1; quarter < m.end; ++quarter) raw_rad_[quarter] = raw_rad_[quarter + 1];
    --m.begin;
    --m.end;
    m.pulled = true;
}

void AxisByQuarters::shorten(int move) {
    const Stretch stretch = *slower_stretch(move);
    AxisMove &m = moves_[move];
    const double from = raw(stretch.begin), way = raw(stretch.end) - from;
    const int last = stretch.end - 1, number = last - stretch.begin;
    for (int k = 1; k < number; ++k) raw_rad_[stretch.begin + k] = from + way * k / number;
    for (int quarter = last; quarter < m.end; ++quarter) raw_rad_[quarter] = raw_rad_[quarter + 1];
    --m.end;
    m.pulled = true;
}

// A move from rest at full speed changes it by half of that at each of its corners.
bool AxisByQuarters::smooth() const {
    for (int quarter = 0; quarter <= end() + 1; ++quarter)
        if (std::abs(change(quarter)) > 0.5 * fastest_rad() + same_rad) return false;
    return true;
}

bool AxisByQuarters::steady(int quarter) const { return std::abs(change(quarter)) < same_rad; }

void AxisByQuarters::take_marks_off() {
    for (AxisMove &move : moves_) move.pulled = false;
}

} // namespace fl::planning
