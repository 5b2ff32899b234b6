// The other positioners near one positioner, step by step.
#pragma once

#include "motion/robot.hpp"

namespace fl::planning {

class MovingObstacles {
  public:
    // Another positioner during one step, or during all steps from first to last if it rests; or, if it or
    // who is looking may be late, what it does at some of them.
    struct Visit {
        Vec2 centre;
        double radius_mm = 0.0; // of the circle around the centre line, during the whole step
        const SweptArm *swept = nullptr;
        int slot = 0; // whose: the place in the list of neighbours
        int cost = 0;
        Cell cell;
        int first = 0;
        int last = 0;
        bool late = false; // at any moment from first to last
        // Whether its circle meets another one.
        bool near(Vec2 at, double other_radius_mm) const {
            const Vec2 gap = centre - at;
            const double touch = other_radius_mm + radius_mm;
            return dot(gap, gap) < touch * touch;
        }
        bool meets(const SweptArm &other, double need_mm) const {
            return late ? !ever_apart(other, *swept, need_mm) : !stay_apart(other, *swept, need_mm);
        }
        // With the distance of both in mid-step.
        bool meets(const SweptArm &other, double middle_mm, double need_mm) const {
            return late ? !ever_apart(other, *swept, middle_mm, need_mm)
                        : !stay_apart(other, *swept, middle_mm, need_mm);
        }
    };

    void clear() { visits_.clear(); }
    // What another one sweeps from a cell, and what touching it costs, per step.
    struct Seen {
        const SweptArm *swept = nullptr;
        int cost = 0;
        Cell cell;
    };
    // From a step to another one; in the order of steps for each positioner.
    void add(int slot, int first, int last, const Seen &seen);
    // What it may do at any moment of some steps, beside what else it may do then.
    void add_late(int slot, const SweptArm &swept, int cost, Cell cell, int first, int last);
    // After the last add: makes the lists by step.
    void sort(int steps);

    // Of one that may stop for good: visits at any step of all. They are not among those of a step.
    const List<int> &always() const { return always_; }
    bool is_always(const Visit &v) const { return v.late && v.first == 0 && v.last == steps_; }
    // Indices of the visits at a step.
    struct View {
        const int *first;
        const int *last;
        const int *begin() const { return first; }
        const int *end() const { return last; }
    };
    View at(int step) const { return {by_step_.data() + ends_[step], by_step_.data() + ends_[step + 1]}; }
    const Visit &visit(int index) const { return visits_[index]; }
    const List<Visit> &visits() const { return visits_; }

  private:
    bool extends_last(int slot, int step, const SweptArm &swept) const;
    static Visit visit_of(const SweptArm &swept, int slot, int cost, Cell cell);

    int steps_ = 0;
    List<Visit> visits_;
    List<int> by_step_;
    List<int> always_;
    List<int> ends_; // in by_step_, of each step; the first is 0
};

} // namespace fl::planning
