// The motion of one axis along a path, by quarters of a step, and its moves between rests.
#pragma once

#include "points/own_knots.hpp"
#include "search/path_set.hpp"

#include <algorithm>

namespace fl::planning {

// From rest to rest, in quarters of the raw motion.
struct AxisMove {
    int begin = 0, end = 0;
    int least_rest = 0;  // before it: so many quarters after the move before
    bool pulled = false; // is a quarter earlier since the marks were taken off
};

// The raw motion is straight between lines, and begins a quarter after the start: what is sent cuts its
// corners, from a quarter before to a quarter after each.
class AxisByQuarters {
  public:
    AxisByQuarters(const AxisGrid &grid, const List<Cell> &path, int Cell::*axis);

    const List<AxisMove> &moves() const { return moves_; }
    int end() const { return moves_.empty() ? 0 : moves_.back().end; }
    // Where it is on the raw motion, and in what is sent.
    double raw(int quarter) const { return raw_rad_[std::clamp(quarter, 0, raw_rad_.size() - 1)]; }
    double sent(int quarter) const;
    // The line that is nearest to the raw motion.
    int nearest(int quarter) const;
    Knots knots() const;

    // The first of the moves that have to be a quarter earlier so that this one can be; -1: it cannot.
    int first_to_pull(int move) const;
    // A quarter earlier. @pre the rest before it is longer than the least one.
    void pull(int move);
    void take_marks_off();

  private:
    void find_moves();
    int rest_before(int move) const { return moves_[move].begin - (move == 0 ? 1 : moves_[move - 1].end); }
    int least_rest(int end, int begin) const;
    bool rests_at(int quarter) const { return raw(quarter) == raw(quarter + 1); }
    bool short_rest_at(int quarter) const {
        return rests_at(quarter) && !rests_at(quarter - 1) && !rests_at(quarter + 1);
    }

    const AxisGrid *grid_;
    List<double> raw_rad_;
    List<AxisMove> moves_;
};

} // namespace fl::planning
