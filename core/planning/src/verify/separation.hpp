// Bodies that overlap when a motion begins: proof that they only move apart.
//
// The signed gap of two bodies is the distance of their centre lines less the sum of their radii; where the
// lines cross, minus the shortest way that takes them apart counts as the distance. Like the distance, it
// changes by no more than the bodies travel. Let M be the largest gap until now. The rule: as long as M is
// below 0, the gap is never more than `slack_mm` below M; afterwards it is never below 0.
#pragma once

#include "verify/track.hpp"

namespace fl::planning {

inline constexpr double slack_mm = 1e-3; // a gap that shall only grow may fall by this

// The distance of two segments, mm; where they cross, minus the shortest shift that parts them.
double signed_distance(const Segment &p, const Segment &q);

// A positioner and either another one or a fixed body.
struct Two {
    const Track &p;
    const Track *q; // null: `fixed` is the other
    Capsule fixed{};

    double end_s() const { return q ? std::max(p.end_s(), q->end_s()) : p.end_s(); }
    double travelled_mm(double time_s) const {
        return p.travelled_mm(time_s) + (q ? q->travelled_mm(time_s) : 0.0);
    }
    // Of the largest parts together.
    double radii_mm() const { return p.radius_mm() + (q ? q->radius_mm() : fixed.radius_mm); }
    // The smallest gap of two parts that share a layer, by a distance of segments; far if none do.
    template <class Distance> double gap_mm(double time_s, Distance distance) const {
        double least = 1e9;
        for (int b = 0; b < (q ? q->parts() : 1); ++b) {
            const Place other = q ? q->place(b, time_s) : Place{fixed.line, fixed.radius_mm, fixed.layers};
            for (int a = 0; a < p.parts(); ++a)
                least = std::min(least, part_gap_mm(p.place(a, time_s), other, distance));
        }
        return least;
    }
};

// Two bodies over time.
class Separation {
  public:
    explicit Separation(Two bodies) : bodies_(bodies) {}

    // Signed gap at a moment, mm.
    double gap_mm(double time_s) const;
    // Moves through the whole motion, in order.
    void prove();

    // By how much the rule is broken, at least, mm, and when; 0: it is kept.
    double closing_mm() const { return closing_mm_; }
    double closing_s() const { return closing_s_; }
    // The smallest gap that was looked at, mm, and its time.
    double smallest_mm() const { return smallest_mm_; }
    double smallest_s() const { return smallest_s_; }
    // At the end of the motion.
    double last_mm() const { return last_mm_; }
    double end_s() const { return bodies_.end_s(); }

  private:
    struct Moment {
        double time_s, gap_mm, travelled_mm;
    };

    Moment look(double time_s);
    void descend(const Moment &from, const Moment &to, int depth);
    bool proven(double lower_mm, double upper_mm, double fall_mm) const;
    void judge(const Moment &at);
    void break_rule(double by_mm, double time_s);

    Two bodies_;
    double highest_mm_ = -1e9; // no gap until now was larger: of bounds
    double seen_mm_ = -1e9;    // the largest gap looked at until now
    double closing_mm_ = 0.0, closing_s_ = 0.0;
    double smallest_mm_ = 1e9, smallest_s_ = 0.0;
    double last_mm_ = 0.0;
    int looks_ = 0;
};

} // namespace fl::planning
