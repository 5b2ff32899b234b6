// One positioner as the search sees it: its two axis grids, its arm at each of their crossings, and the
// bodies at rest around it.
#pragma once

#include "bodies/body.hpp"
#include "fiberloom/planning.hpp"
#include "motion/grid.hpp"
#include "motion/swept_arm.hpp"

#include <cstdint>
#include <optional>

namespace fl::planning {

// A crossing of the two grids: line numbers of alpha and beta.
struct Cell {
    int alpha = 0;
    int beta = 0;
    friend bool operator==(Cell p, Cell q) { return p.alpha == q.alpha && p.beta == q.beta; }
};

struct VelocityChanges {
    VelocityChange alpha;
    VelocityChange beta;
    // 0 .. 80
    int code() const { return ((alpha.from + 1) * 3 + alpha.to + 1) * 9 + (beta.from + 1) * 3 + beta.to + 1; }
    bool rests() const { return alpha.from == 0 && alpha.to == 0 && beta.from == 0 && beta.to == 0; }
};

class Robot {
  public:
    // step_rad: widest step of the grids.
    Robot(const ArmBody &body, AxisGrid alpha, AxisGrid beta, double step_rad);

    const AxisGrid &alpha() const { return alpha_; }
    const AxisGrid &beta() const { return beta_; }
    Cell start() const { return {alpha_.start(), beta_.start()}; }
    Cell goal() const { return {alpha_.goal(), beta_.goal()}; }
    int cells() const { return alpha_.size() * beta_.size(); }
    int index(Cell c) const { return c.beta * alpha_.size() + c.alpha; }
    // Steps from a cell to the goal if nothing is between.
    int steps_to_goal(Cell c) const {
        const int a = c.alpha - alpha_.goal(), b = c.beta - beta_.goal();
        return std::max(a < 0 ? -a : a, b < 0 ? -b : b);
    }
    // Whether the cells of another have the same angles.
    bool same_grid(const Robot &other) const {
        return alpha_.same_as(other.alpha_) && beta_.same_as(other.beta_);
    }
    int travel_steps() const { return steps_to_goal(start()); }
    bool inside(Cell c) const {
        return c.alpha >= 0 && c.beta >= 0 && c.alpha < alpha_.size() && c.beta < beta_.size();
    }

    Segment line(Cell c) const { return body_.line(alpha_.turn(c.alpha), beta_.turn(c.beta)); }
    // Where the arm is at mid-step.
    Segment middle_line(Cell c, VelocityChanges changes) const {
        return body_.line(alpha_.turn(c.alpha, changes.alpha, 2), beta_.turn(c.beta, changes.beta, 2));
    }
    // How far its points get from there during the step, at most, with what is kept in hand.
    double displacement_bound_mm(VelocityChanges changes) const {
        return displacement_bounds_[changes.code()];
    }
    SweptArm swept(Cell c, VelocityChanges changes) const;
    // At these angles at the borders of the quarters, near a cell; nowhere faster than on the grid.
    SweptArm swept(Cell near, const Angles (&at)[quarters + 1]) const;
    // No step around a cell takes a point of the arm farther than this from its place at the cell, with what
    // is kept in hand.
    double widest_displacement_mm() const { return widest_displacement_mm_; }
    // Of a step, at most, with what is kept in hand.
    double bulge_mm() const { return bulge_mm_ + in_hand_mm_; }
    double reach_mm() const { return body_.reach_mm(); }
    double extra_mm() const { return body_.extra_mm; }
    const Shape *shape() const { return body_.shape; }
    // Whether the arm is one line from its elbow on; how long that is.
    bool from_elbow() const { return body_.shape == nullptr && body_.from_mm == 0.0 && body_.to_mm > 0.0; }
    double length_mm() const { return body_.to_mm - body_.from_mm; }
    SweptArm resting(Cell c) const { return body_.resting(line(c)); }
    // Its limbs, at no place.
    const SweptArm &limbs() const { return limbs_; }
    Vec2 centre() const { return body_.arm.centre_mm; }

    // From now on an arm that moves keeps so much more to all others than they need, but where both axes are
    // within an angle of the start, or of the goal: there it may have to be as near as that.
    // @pre no obstacle has been added.
    void keep_in_hand(double mm, double free_rad);
    // What it does after it has come to its goal on the grid. Only for those that may be late.
    // @pre nothing more is kept in hand afterwards, no obstacle has been added.
    void set_legs(List<SweptArm> legs);
    const List<SweptArm> &legs() const { return legs_; }
    // A body at rest, whose centre line must be kept need_mm and its extra radius away.
    void add_obstacle(const SweptArm &body, double need_mm);
    // Whether a step stays clear of every body at rest.
    bool clear(Cell c, VelocityChanges changes);
    bool clear(const SweptArm &swept) const;
    // False only if the arm overlaps a body at rest at all angles that are nearer to this cell than to
    // others.
    bool may_be_at(Cell c) const;
    // Steps to the goal past the bodies at rest, with a stop at each cell; -1 if there is no path.
    int steps_alone();
    // The cells of such a path, from the start to the goal; none if there is no path.
    List<Cell> way_alone();
    // The same between each cell, by its index, and the goal, or the start; found once.
    const List<int> &steps_from_goal();
    const List<int> &steps_from_start();
    // Cells that it can come to past the bodies at rest, the nearest first.
    List<Cell> reachable();

  private:
    struct Flood {
        List<Cell> cells; // in the order in which they are reached
        List<int> steps;  // to each cell, by its index; -1: not reached
    };
    bool clear_move(Cell here, Cell next);
    bool straight_is_clear();
    // With a stop at each cell; it ends at one cell, if that is given.
    Flood flood(Cell from, std::optional<Cell> until);
    const List<int> &steps_from(Cell end, List<int> &known);
    struct Obstacle {
        SweptArm swept; // the same at every moment
        double need_mm = 0.0;
    };
    // What is known of the steps around a cell.
    enum Clearance : std::uint8_t { unknown, all_clear, some_clear, none_clear };
    Clearance look(Cell c) const;
    bool within_free(Cell c, Cell end) const;
    double in_hand_mm(Cell c) const;

    ArmBody body_;
    SweptArm limbs_;
    AxisGrid alpha_, beta_;
    double bulge_mm_ = 0.0, widest_displacement_mm_ = 0.0;
    double displacement_bounds_[81] = {};
    double in_hand_mm_ = 0.0, free_rad_ = 0.0;
    List<SweptArm> legs_;
    List<Obstacle> obstacles_;
    List<Clearance> clearances_;       // per cell, once looked at
    List<int> from_start_, from_goal_; // steps, once asked for
};

} // namespace fl::planning
