// The motion of one axis along a path, by quarters of a step, and its moves between rests.
#pragma once

#include "points/own_knots.hpp"
#include "search/path_set.hpp"

#include <algorithm>
#include <optional>

namespace fl::planning {

// Where a quarter comes from: from rests alone, from them or else from what is slower than the axis can go,
// or the other way round.
enum class Spare { rests, rests_first, slower_first };

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

    // The first of the moves that have to be a quarter earlier so that this one ends earlier, or that has to
    // take a quarter less.
    struct First {
        int move = 0;
        bool shorter = false;
    };
    std::optional<First> first_to_pull(int move, Spare spare) const;
    // A quarter earlier. @pre the rest before it is longer than the least one.
    void pull(int move);
    // A quarter shorter: the last stretch that can be goes faster, what follows it is earlier. @pre there is
    // one.
    void shorten(int move);
    void take_marks_off();
    // Whether what is sent keeps its speed in a quarter; and whether no corner of it is sharper than on a
    // path.
    bool steady(int quarter) const;
    bool smooth() const;

  private:
    double change(int quarter) const { // of speed, rad a quarter
        return sent(quarter + 1) - 2.0 * sent(quarter) + sent(quarter - 1);
    }
    void find_moves();
    int rest_before(int move) const { return moves_[move].begin - (move == 0 ? 1 : moves_[move - 1].end); }
    int least_rest(int end, int begin) const;
    // At one speed, between two quarters of the raw motion.
    struct Stretch {
        int begin = 0, end = 0;
    };
    double fastest_rad() const { return grid_->step_rad() / quarters; } // in a quarter
    int begin_of_stretch(int end, int first) const;
    std::optional<Stretch> slower_stretch(int move) const;
    bool rests_at(int quarter) const { return raw(quarter) == raw(quarter + 1); }
    bool short_rest_at(int quarter) const {
        return rests_at(quarter) && !rests_at(quarter - 1) && !rests_at(quarter + 1);
    }

    const AxisGrid *grid_;
    List<double> raw_rad_;
    List<AxisMove> moves_;
};

} // namespace fl::planning
