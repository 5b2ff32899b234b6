// What is near one positioner, and when.
#pragma once

#include "piece.hpp"

#include <vector>

namespace fl::planning {

class Crowd {
  public:
    // Another positioner during one step, or during all steps from first to last if it rests.
    struct Visit {
        Vec2 centre;
        double radius_mm = 0.0; // of the circle around the centre line, during the whole step
        const Piece *piece = nullptr;
        int robot = -1;
        int cost = 0;
        int first = 0;
        int last = 0;
    };

    void clear() { visits_.clear(); }
    // In the order of steps for each positioner.
    void add(int robot, int step, const Piece &piece, int cost);
    // After the last add: makes the lists by step.
    void sort(int steps);

    const std::vector<Visit> &visits() const { return visits_; }

    // Indices of the visits at a step.
    struct View {
        const int *first;
        const int *last;
        const int *begin() const { return first; }
        const int *end() const { return last; }
    };
    View at(int step) const {
        const auto k = static_cast<size_t>(step);
        return {by_step_.data() + ends_[k], by_step_.data() + ends_[k + 1]};
    }
    const Visit &visit(int index) const { return visits_[static_cast<size_t>(index)]; }

  private:
    std::vector<Visit> visits_;
    std::vector<int> by_step_;
    std::vector<size_t> ends_;
};

} // namespace fl::planning
