#include "search/moving_obstacles.hpp"

namespace fl::planning {
namespace {

bool rests(const SweptArm &swept) { return swept.displacement_bound_mm == 0.0; }

bool same_place(const Segment &p, const Segment &q) {
    return p.a.x == q.a.x && p.a.y == q.a.y && p.b.x == q.b.x && p.b.y == q.b.y;
}

} // namespace

// A positioner that rests goes on resting where it was in the step before.
bool MovingObstacles::extends_last(int slot, int step, const SweptArm &swept) const {
    if (!rests(swept) || visits_.empty()) return false;
    const Visit &before = visits_.back();
    return before.slot == slot && before.last == step - 1 && rests(*before.swept) &&
           same_place(before.swept->at[2], swept.at[2]);
}

MovingObstacles::Visit MovingObstacles::visit_of(const SweptArm &swept, int slot, int cost, Cell cell) {
    const Segment &mid = swept.at[2];
    const double radius = 0.5 * length(mid.b - mid.a) + swept.displacement_bound_mm + swept.extra_mm;
    return {middle(mid.a, mid.b), radius, &swept, slot, cost, cell};
}

void MovingObstacles::add(int slot, int first, int last, const Seen &seen) {
    if (extends_last(slot, first, *seen.swept)) {
        visits_.back().last = last;
        return;
    }
    Visit visit = visit_of(*seen.swept, slot, seen.cost, seen.cell);
    visit.first = first;
    visit.last = last;
    visits_.push_back(visit);
}

void MovingObstacles::add_late(int slot, const SweptArm &swept, int cost, Cell cell, int first, int last) {
    Visit visit = visit_of(swept, slot, cost, cell);
    visit.first = first;
    visit.last = last;
    visit.late = true;
    visits_.push_back(visit);
}

void MovingObstacles::sort(int steps) {
    steps_ = steps;
    always_.clear();
    for (int i = 0; i < visits_.size(); ++i)
        if (is_always(visits_[i])) always_.push_back(i);
    ends_.assign(steps + 2, 0);
    for (const Visit &v : visits_)
        for (int k = v.first; k <= v.last && !is_always(v); ++k) ++ends_[k + 1];
    for (int k = 1; k < ends_.size(); ++k) ends_[k] += ends_[k - 1];
    by_step_.resize(ends_.back());
    List<int> next = ends_;
    for (int i = 0; i < visits_.size(); ++i)
        for (int k = visits_[i].first; k <= visits_[i].last && !is_always(visits_[i]); ++k)
            by_step_[next[k]++] = i;
}

} // namespace fl::planning
