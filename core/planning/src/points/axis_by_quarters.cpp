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
    for (int quarter = 1; quarter <= end() + 1; ++quarter) {
        const double before = sent(quarter) - sent(quarter - 1), after = sent(quarter + 1) - sent(quarter);
        if (std::abs(after - before) >= same_rad) out.push_back({quarter, sent(quarter)});
    }
    return out;
}

int AxisByQuarters::first_to_pull(int move) const {
    for (int k = move; k >= 0; --k) {
        if (k < move && moves_[k].pulled) return k + 1;
        if (rest_before(k) > moves_[k].least_rest) return k;
    }
    return -1;
}

void AxisByQuarters::pull(int move) {
    AxisMove &m = moves_[move];
    for (int quarter = m.begin - 1; quarter < m.end; ++quarter) raw_rad_[quarter] = raw_rad_[quarter + 1];
    --m.begin;
    --m.end;
    m.pulled = true;
}

void AxisByQuarters::take_marks_off() {
    for (AxisMove &move : moves_) move.pulled = false;
}

} // namespace fl::planning
