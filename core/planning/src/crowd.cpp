#include "crowd.hpp"

namespace fl::planning {

void Crowd::add(int robot, int step, const Piece &piece, int cost) {
    const Segment &mid = piece.at[2];
    const bool rests = piece.sway_mm == 0.0;
    if (rests && !visits_.empty()) {
        Visit &before = visits_.back();
        const Segment &there = before.piece->at[2];
        const bool same = before.robot == robot && before.last == step - 1 && before.piece->sway_mm == 0.0 &&
                          there.a.x == mid.a.x && there.a.y == mid.a.y && there.b.x == mid.b.x &&
                          there.b.y == mid.b.y;
        if (same) {
            before.last = step;
            return;
        }
    }
    const double radius = 0.5 * length(mid.b - mid.a) + piece.sway_mm;
    visits_.push_back({middle(mid.a, mid.b), radius, &piece, robot, cost, step, step});
}

void Crowd::sort(int steps) {
    ends_.assign(static_cast<size_t>(steps) + 2, 0);
    for (const Visit &v : visits_)
        for (int k = v.first; k <= v.last; ++k) ++ends_[static_cast<size_t>(k) + 1];
    for (size_t k = 1; k < ends_.size(); ++k) ends_[k] += ends_[k - 1];
    by_step_.resize(ends_.back());
    std::vector<size_t> next(ends_.begin(), ends_.end() - 1);
    for (size_t i = 0; i < visits_.size(); ++i)
        for (int k = visits_[i].first; k <= visits_[i].last; ++k)
            by_step_[next[static_cast<size_t>(k)]++] = static_cast<int>(i);
}

} // namespace fl::planning
