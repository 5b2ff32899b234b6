// Motions as the verifier sees them: where an arm is at any moment, and how far it has travelled.
#pragma once

#include "fiberloom/verify.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace fl::planning {

inline constexpr double touching_mm = 1e-6; // gaps are proven to be above minus this

inline int count(const auto &list) { return static_cast<int>(list.size()); }

// One positioner over time: where its arm is, and how far it has travelled.
class Track {
  public:
    Track(const Arm &arm, double from_mm, double to_mm, const Motion &motion)
        : arm_(arm), from_mm_(from_mm), to_mm_(to_mm), motion_(motion),
          travelled_(motion.time_s.size(), 0.0) {
        const double far = std::max(std::abs(from_mm), std::abs(to_mm));
        for (int k = 1; k < count(travelled_); ++k) {
            const double a = motion.angles[k].alpha_rad - motion.angles[k - 1].alpha_rad;
            const double b = motion.angles[k].beta_rad - motion.angles[k - 1].beta_rad;
            travelled_[k] = travelled_[k - 1] + std::abs(arm.l_alpha_mm * a) + far * std::abs(a + b);
        }
    }

    double end_s() const { return motion_.time_s.back(); }
    bool moves() const { return travelled_.back() > 0.0; }
    double reach_mm() const {
        return std::abs(arm_.l_alpha_mm) + std::max(std::abs(from_mm_), std::abs(to_mm_));
    }
    Vec2 centre_mm() const { return arm_.centre_mm; }

    Segment line(double time_s) const {
        const auto [k, part] = locate(time_s);
        if (part == 0.0) return beta_segment(arm_, from_mm_, to_mm_, motion_.angles[k]);
        const Angles p = motion_.angles[k], q = motion_.angles[k + 1];
        return beta_segment(arm_, from_mm_, to_mm_,
                            {p.alpha_rad + part * (q.alpha_rad - p.alpha_rad),
                             p.beta_rad + part * (q.beta_rad - p.beta_rad)});
    }

    double travelled_mm(double time_s) const {
        const auto [k, part] = locate(time_s);
        return part == 0.0 ? travelled_[k] : travelled_[k] + part * (travelled_[k + 1] - travelled_[k]);
    }

  private:
    // The point before a moment, and which part of the way to the next one is done.
    std::pair<int, double> locate(double time_s) const {
        const auto &t = motion_.time_s;
        if (time_s <= t.front()) return {0, 0.0};
        if (time_s >= t.back()) return {count(t) - 1, 0.0};
        const int k = static_cast<int>(std::upper_bound(t.begin(), t.end(), time_s) - t.begin()) - 1;
        return {k, (time_s - t[k]) / (t[k + 1] - t[k])};
    }

    const Arm &arm_;
    double from_mm_, to_mm_;
    const Motion &motion_;
    std::vector<double> travelled_;
};

} // namespace fl::planning
