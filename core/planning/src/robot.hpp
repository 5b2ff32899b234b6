// One positioner as the search sees it: its two axis grids, its arm at each of their crossings, and what
// stands still around it.
#pragma once

#include "fiberloom/planning.hpp"
#include "grid.hpp"
#include "piece.hpp"

#include <array>
#include <cstdint>
#include <vector>

namespace fl::planning {

// A crossing of the two grids: line numbers of alpha and beta.
struct Cell {
    int alpha = 0;
    int beta = 0;
    friend bool operator==(Cell p, Cell q) { return p.alpha == q.alpha && p.beta == q.beta; }
};

struct Bends {
    Bend alpha;
    Bend beta;
    // 0 .. 80
    size_t code() const {
        return static_cast<size_t>(((alpha.from + 1) * 3 + alpha.to + 1) * 9 + (beta.from + 1) * 3 + beta.to +
                                   1);
    }
    bool rests() const { return alpha.from == 0 && alpha.to == 0 && beta.from == 0 && beta.to == 0; }
};

// A body that does not move, as a step of its own, and how far its centre line must be kept away.
struct Obstacle {
    Piece piece;
    double need_mm = 0.0;
};

class Robot {
  public:
    Robot(const Arm &arm, double from_mm, double to_mm, AxisGrid alpha, AxisGrid beta, double step_rad);

    const AxisGrid &alpha() const { return alpha_; }
    const AxisGrid &beta() const { return beta_; }
    Cell start() const { return {alpha_.start(), beta_.start()}; }
    Cell goal() const { return {alpha_.goal(), beta_.goal()}; }
    int cells() const { return alpha_.size() * beta_.size(); }
    int index(Cell c) const { return c.beta * alpha_.size() + c.alpha; }
    // Steps from a cell to the goal if nothing is in the way.
    int steps_to_goal(Cell c) const {
        const int a = c.alpha - alpha_.goal(), b = c.beta - beta_.goal();
        return std::max(a < 0 ? -a : a, b < 0 ? -b : b);
    }
    int travel_steps() const { return steps_to_goal(start()); }
    bool inside(Cell c) const {
        return c.alpha >= 0 && c.beta >= 0 && c.alpha < alpha_.size() && c.beta < beta_.size();
    }

    Segment line(Cell c) const { return line(alpha_.turn(c.alpha), beta_.turn(c.beta)); }
    // Where the arm is at mid-step, and how far its points get from there during the step.
    Segment middle_line(Cell c, Bends bends) const {
        return line(alpha_.turn(c.alpha, bends.alpha, 2), beta_.turn(c.beta, bends.beta, 2));
    }
    double sway_mm(Bends bends) const { return sways_[bends.code()]; }
    Piece piece(Cell c, Bends bends) const;
    // No step around a cell takes a point of the arm farther than this from its place at the cell.
    double widest_sway_mm() const { return widest_sway_mm_; }
    double bulge_mm() const { return bulge_mm_; }
    double reach_mm() const { return reach_mm_; }
    Vec2 centre() const { return arm_.centre_mm; }

    void add_obstacle(const Segment &body, double need_mm);
    // Whether a step stays clear of everything that stands still.
    bool clear(Cell c, Bends bends);
    bool clear(const Piece &piece) const;
    // Steps to the goal past what stands still, with a stop at each cell; -1 if there is no way.
    int steps_alone();

  private:
    enum State : std::uint8_t { unknown, all_clear, some_clear, none_clear };
    State look(Cell c) const;
    Segment line(Turn alpha, Turn beta) const {
        const Turn u = alpha * beta;
        const Vec2 e{arm_.centre_mm.x + arm_.l_alpha_mm * alpha.c,
                     arm_.centre_mm.y + arm_.l_alpha_mm * alpha.s};
        return {{e.x + from_mm_ * u.c, e.y + from_mm_ * u.s}, {e.x + to_mm_ * u.c, e.y + to_mm_ * u.s}};
    }

    Arm arm_;
    double from_mm_ = 0.0, to_mm_ = 0.0;
    AxisGrid alpha_, beta_;
    double bulge_mm_ = 0.0, widest_sway_mm_ = 0.0, reach_mm_ = 0.0;
    std::array<double, 81> sways_{};
    std::vector<Obstacle> obstacles_;
    std::vector<State> states_; // per cell, once looked at
};

} // namespace fl::planning
