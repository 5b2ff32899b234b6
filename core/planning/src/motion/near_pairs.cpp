#include "motion/near_pairs.hpp"

#include <algorithm>
#include <cmath>

namespace fl::planning {
namespace {

class Bins {
  public:
    Bins(const List<Vec2> &centres, double widest_mm) : centres_(centres), size_mm_(widest_mm) {
        Vec2 high = low_ = centres.front();
        for (const Vec2 c : centres) {
            low_ = {std::min(low_.x, c.x), std::min(low_.y, c.y)};
            high = {std::max(high.x, c.x), std::max(high.y, c.y)};
        }
        // no more bins than centres, however far apart these are
        const double most = std::sqrt(static_cast<double>(centres.size()));
        size_mm_ = std::max({size_mm_, (high.x - low_.x) / most, (high.y - low_.y) / most});
        columns_ = column(high.x) + 1;
        rows_ = line(high.y) + 1;
        sort();
    }

    // The centres of a bin in ascending order; none outside.
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
        for (const Vec2 c : centres_) ++begins_[bin(c) + 1];
        for (int k = 1; k < begins_.size(); ++k) begins_[k] += begins_[k - 1];
        List<int> next = begins_;
        sorted_.resize(centres_.size());
        for (int k = 0; k < centres_.size(); ++k) sorted_[next[bin(centres_[k])]++] = k;
    }
    int bin(Vec2 c) const { return line(c.y) * columns_ + column(c.x); }

    const List<Vec2> &centres_;
    double size_mm_;
    Vec2 low_;
    int columns_ = 0, rows_ = 0;
    List<int> begins_, sorted_;
};

} // namespace

List<NearPair> near_pairs(const List<Vec2> &centres, double widest_mm) {
    List<NearPair> out;
    if (centres.empty()) return out;
    const Bins bins(centres, widest_mm);
    for (int i = 0; i < centres.size(); ++i) {
        const int column = bins.column(centres[i].x), line = bins.line(centres[i].y);
        for (int across = -1; across <= 1; ++across)
            for (int up = -1; up <= 1; ++up)
                bins.each(column + across, line + up, [&](int j) {
                    const double gap = length(centres[i] - centres[j]);
                    if (j > i && gap < widest_mm) out.push_back({i, j, gap});
                });
    }
    return out;
}

} // namespace fl::planning
