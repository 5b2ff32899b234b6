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

// A part of a body at one moment.
struct Place {
    Segment line;
    double radius_mm = 0.0;
    Layers layers = all_layers;
    bool on_alpha = false;
};

// The gap of two parts, by a distance of segments; far if they cannot touch.
template <class Distance> double part_gap_mm(const Place &p, const Place &q, Distance distance) {
    if ((p.layers & q.layers) == 0 || (p.on_alpha && q.on_alpha)) return 1e9;
    return distance(p.line, q.line) - (p.radius_mm + q.radius_mm);
}

// One positioner over time: where its parts are, and how far it has travelled.
class Track {
  public:
    Track(const Arm &arm, const std::vector<Part> &parts, const Motion &motion)
        : arm_(arm), parts_(parts), motion_(motion), travelled_(motion.time_s.size(), 0.0) {
        for (const Part &part : parts) {
            double &far = part.on_alpha ? alpha_far_mm_ : beta_far_mm_;
            for (const Vec2 end : {part.line.a, part.line.b}) far = std::max(far, std::hypot(end.x, end.y));
            radius_mm_ = std::max(radius_mm_, part.radius_mm);
        }
        for (int k = 1; k < count(travelled_); ++k) {
            const double a = motion.angles[k].alpha_rad - motion.angles[k - 1].alpha_rad;
            const double b = motion.angles[k].beta_rad - motion.angles[k - 1].beta_rad;
            const double way = std::abs(arm.l_alpha_mm * a) + beta_far_mm_ * std::abs(a + b);
            travelled_[k] = travelled_[k - 1] + std::max(way, alpha_far_mm_ * std::abs(a));
        }
    }

    double end_s() const { return motion_.time_s.back(); }
    bool moves() const { return travelled_.back() > 0.0; }
    double reach_mm() const { return std::max(std::abs(arm_.l_alpha_mm) + beta_far_mm_, alpha_far_mm_); }
    // The largest of its parts.
    double radius_mm() const { return radius_mm_; }
    Vec2 centre_mm() const { return arm_.centre_mm; }

    int parts() const { return count(parts_); }
    Place place(int part, double time_s) const {
        const Part &body = parts_[part];
        const Angles now = angles(time_s);
        const double alpha = now.alpha_rad + arm_.alpha_off_rad;
        const double turn = body.on_alpha ? alpha : alpha + now.beta_rad + arm_.beta_off_rad;
        const Vec2 origin = body.on_alpha ? arm_.centre_mm : elbow(arm_, now.alpha_rad);
        const double c = std::cos(turn), s = std::sin(turn);
        const auto at = [&](Vec2 p) {
            return Vec2{origin.x + (p.x * c - p.y * s), origin.y + (p.x * s + p.y * c)};
        };
        return {{at(body.line.a), at(body.line.b)}, body.radius_mm, body.layers, body.on_alpha};
    }

    double travelled_mm(double time_s) const {
        const auto [k, part] = locate(time_s);
        return part == 0.0 ? travelled_[k] : travelled_[k] + part * (travelled_[k + 1] - travelled_[k]);
    }

  private:
    Angles angles(double time_s) const {
        const auto [k, part] = locate(time_s);
        if (part == 0.0) return motion_.angles[k];
        const Angles p = motion_.angles[k], q = motion_.angles[k + 1];
        return {p.alpha_rad + part * (q.alpha_rad - p.alpha_rad),
                p.beta_rad + part * (q.beta_rad - p.beta_rad)};
    }

    // The point before a moment, and which part of the way to the next one is done.
    std::pair<int, double> locate(double time_s) const {
        const auto &t = motion_.time_s;
        if (time_s <= t.front()) return {0, 0.0};
        if (time_s >= t.back()) return {count(t) - 1, 0.0};
        const int k = static_cast<int>(std::upper_bound(t.begin(), t.end(), time_s) - t.begin()) - 1;
        return {k, (time_s - t[k]) / (t[k + 1] - t[k])};
    }

    const Arm &arm_;
    const std::vector<Part> &parts_;
    double alpha_far_mm_ = 0.0, beta_far_mm_ = 0.0, radius_mm_ = 0.0;
    const Motion &motion_;
    std::vector<double> travelled_;
};

} // namespace fl::planning
