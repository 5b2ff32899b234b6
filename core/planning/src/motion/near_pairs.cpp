#include "motion/near_pairs.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

class Bins {
  public:
    Bins(const List<Reach> &bodies, double widest_mm) : bodies_(bodies), size_mm_(widest_mm) {
        Vec2 high = low_ = bodies.front().centre_mm;
        for (const auto &[c, far] : bodies) {
            low_ = {std::min(low_.x, c.x), std::min(low_.y, c.y)};
            high = {std::max(high.x, c.x), std::max(high.y, c.y)};
        }
        // no more bins than bodies, however far apart these are
        const double most = std::sqrt(static_cast<double>(bodies.size()));
        size_mm_ = std::max({size_mm_, (high.x - low_.x) / most, (high.y - low_.y) / most});
        columns_ = column(high.x) + 1;
        rows_ = line(high.y) + 1;
        sort();
    }

    // The bodies of a bin in ascending order; none outside.
    template <class Visit> void each(int column, int line, Visit visit) const {
        if (column < 0 || line < 0 || column >= columns_ || line >= rows_) return;
        const int bin = line * columns_ + column;
        for (int k = begins_[bin]; k < begins_[bin + 1]; ++k) visit(sorted_[k]);
    }
    int column(double x) const { return static_cast<int>((x - low_.x) / size_mm_); }
    int line(double y) const { return static_cast<int>((y - low_.y) / size_mm_); }

  private:
    void sort() {
        begins_.assign(columns_ * rows_ + 1, 0);
        for (const Reach &body : bodies_) ++begins_[bin(body.centre_mm) + 1];
        for (int k = 1; k < begins_.size(); ++k) begins_[k] += begins_[k - 1];
        List<int> next = begins_;
        sorted_.resize(bodies_.size());
        for (int k = 0; k < bodies_.size(); ++k) sorted_[next[bin(bodies_[k].centre_mm)]++] = k;
    }
    int bin(Vec2 c) const { return line(c.y) * columns_ + column(c.x); }

    const List<Reach> &bodies_;
    double size_mm_;
    Vec2 low_;
    int columns_ = 0, rows_ = 0;
    List<int> begins_, sorted_;
};

} // namespace

List<NearPair> near_pairs(const List<Reach> &bodies, double need_mm) {
    List<NearPair> out;
    if (bodies.empty()) return out;
    double farthest = 0.0;
    for (const Reach &body : bodies) farthest = std::max(farthest, body.far_mm);
    const Bins bins(bodies, 2.0 * farthest + need_mm);
    for (int i = 0; i < bodies.size(); ++i) {
        const auto &[centre, far] = bodies[i];
        const int column = bins.column(centre.x), line = bins.line(centre.y);
        const auto look = [&](int j) {
            const double gap = length(centre - bodies[j].centre_mm);
            if (j > i && gap < far + bodies[j].far_mm + need_mm) out.push_back({i, j, gap});
        };
        for (int across = -1; across <= 1; ++across)
            for (int up = -1; up <= 1; ++up) bins.each(column + across, line + up, look);
    }
    return out;
}

} // namespace fl::planning
