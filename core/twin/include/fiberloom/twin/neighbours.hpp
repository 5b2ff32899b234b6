// Arms that touch push each other: contact forces between beta arms, and between beta arms and what
// does not move (fiducials, guide cameras).
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"
#include "fiberloom/twin/axis_group.hpp"
#include "fiberloom/twin/plant_params.hpp"

namespace fl::twin {

// Arms exchange where they are at these ticks, and those that touch at every tick. An arm's tip moves 9 um
// between two of them at 2000 rpm.
inline constexpr uint64_t sync_ticks = 4;
inline constexpr uint64_t longest_ticks = 256; // for which a bound of a motion is worked out

// A capsule that does not move; a disc when both ends coincide.
struct Obstacle {
    Segment centre_line_mm;
    double radius_mm = 0.0;
};

// The beta arm's capsule: what is there, not the buffer that planning keeps. From x = from_mm to x = to_mm of
// the arm's frame.
struct Body {
    double from_mm = 0.0, to_mm = 14.7, radius_mm = 1.5;
};

// How one arm gives way and how it can move, per axis.
struct Give {
    double compliance_rad_per_Nm[2] = {0.0, 0.0};
    SpeedBound speed[2];                     // of its motors
    double output_per_motor[2] = {0.0, 0.0}; // the most that the output turns for a rad of its motor
};

// Two bodies began to touch in this tick.
struct Touch {
    uint64_t tick;
    uint32_t first, second; // positioners; second = positioner_count + k is obstacle k
};

// Torque on the two axes of a positioner, Nm at the output.
struct Push {
    double torque_Nm[2] = {0.0, 0.0}; // alpha, beta
    bool operator==(const Push &) const = default;
};

// How far an arm has come, see Neighbours::travel_mm, and how fast it goes now.
struct Travel {
    double way_mm = 0.0;
    double speed_mm = 0.0; // a tick; below zero: it is pushed
    static constexpr double pushed = -1.0;
};

// Where an arm is.
struct Pose {
    Angles angles;    // deflected by what pushes it
    Segment line;     // of its capsule
    double spring_mm; // how far it springs at most when it is let go
};

// A contact as one of the two feels it; kept from one sync point to the next.
struct Contact {
    uint32_t other; // numbered as in Touch
    int place;      // 0, 1: at an end of the keeper's centre line; 2, 3: of the other's; 4: they cross
    Vec2 force_N;   // on the keeper
};

// Whether one of the contacts is with the other body.
inline bool in_touch(const std::vector<Contact> &contacts, uint32_t other) {
    for (const Contact &c : contacts)
        if (c.other == other) return true;
    return false;
}

// Contact forces of all arms of a focal plane.
class Neighbours {
  public:
    Neighbours() = default;
    // One row of `gives` for each arm. bound_scale: every bound of a motion is so many times itself; above
    // 1 pairs are looked at more often than they need to be, with the same answers. @pre arms and gives have
    // the same size.
    Neighbours(std::vector<Arm> arms, std::vector<Obstacle> obstacles, Body body,
               const std::vector<Give> &gives, double bound_scale = 1.0);

    // Positioner i at these angles; rigid: where it would spring to.
    Pose pose(size_t i, Angles deflected, Angles rigid) const;

    // What push() would find at tick 0 of pairs that do not touch then: the first tick has less to do, and
    // the answers stay the same to the bit. Once, before any push(). poses: as push() is given them at tick
    // 0.
    void plan_first_looks(const std::vector<Pose> &poses);

    // What is asked of push() at one tick.
    struct Moment {
        const std::vector<Pose> &poses;     // of all positioners at the last sync point
        const std::vector<Travel> &travels; // and how they move there
        uint64_t tick;
        uint64_t
            ahead; // pairs that are due within so many more ticks are looked at now: a slice may be longer
    };
    // Torque on positioner i by all that it touches. Far neighbours are left out until they could have
    // come near: the answer does not depend on it. `contacts` are those of the last sync point, and
    // then those of this. Any thread, one call per positioner at a time.
    Push push(size_t i, const Moment &at, std::vector<Contact> &contacts);

    // The first tick at which something could touch positioner i, as far as speeds tell.
    uint64_t due(size_t i) const { return next_look_[i]; }
    // The first tick at which something could touch something.
    uint64_t next_due() const;
    // Whether push() needs the pose of positioner i for pairs that are due at this tick: two look at each
    // other at the same ticks, and only if they have travelled as far as they were apart, but for a slice.
    bool shown(size_t i, uint64_t tick) const { return tick >= next_exact_[i]; }
    // What was known of positioner i no longer holds: it is pushed, or has been bent. All its pairs are
    // looked at by their poses at this tick, a sync point. No push() at the same time.
    void disturb(size_t i, uint64_t tick);

    // How far a point of arm i has come at most when its motors have turned so far, rad. Sums of it,
    // sync point by sync point, are the travels of push().
    double travel_mm(size_t i, double alpha_rad, double beta_rad) const {
        return levers_mm_[i].alpha * alpha_rad + levers_mm_[i].beta * beta_rad;
    }
    // The farthest that one that is pushed can come from one sync point to the next.
    double farthest_mm(size_t i) const { return pushed_mm(i) * static_cast<double>(sync_ticks); }
    // The farthest that a point of arm i can come within so many ticks, a multiple of sync_ticks up to
    // longest_ticks, given how it moves now.
    double bound_mm(size_t i, const Travel &now, uint64_t ticks) const;
    // Arm i can do this from now on beside what it could. True where that makes bounds of all arms wider:
    // then none of them is to be trusted, see disturb(). Compliances stay.
    bool allow(size_t i, const Give &give);
    // So far apart may two places be in which the output is seen for the same angle of its motors. True as
    // above.
    bool allow_loose(size_t i, Angles loose);

    // Memory of all positioners together.
    size_t bytes() const;
    // The arm of positioner i.
    const Arm &arm(size_t i) const { return arms_[i]; }
    // Number of arms.
    size_t positioner_count() const { return arms_.size(); }

  private:
    struct ContactPoint {
        Vec2 point_mm, normal; // on the arm; unit vector that pushes it away
        double depth_mm;
    };
    struct Look { // one positioner at one sync point
        size_t i;
        Moment at;
        const std::vector<Contact> &before;
        std::vector<Contact> now;
        Push push;
    };
    // Of a pair, as one of the two keeps it: 12 bytes, for all pairs of a plane are gone through.
    struct Near {
        static constexpr int number_bits = 20, worth_bits = 11; // a million, 128 mm
        static constexpr double worth_per_mm = 16.0;
        uint32_t next_look;            // tick before which the two cannot touch, modulo 2^32
        uint32_t meet_um;              // they cannot until both have travelled so far, modulo 2^32
        uint32_t exact : 1;            // looked at by their poses then, else by their travels
        uint32_t number : number_bits; // as in Touch
        uint32_t worth : worth_bits;   // nearer by their travels than this, another exact look pays

        // How long after the tick `first` the next look is. All pairs of a positioner are looked at from
        // `first` on, none 24 days later.
        uint32_t ticks_after(uint64_t first) const { return next_look - static_cast<uint32_t>(first); }
        void set_worth(double mm) {
            constexpr double most = (1U << worth_bits) - 1;
            worth =
                static_cast<uint32_t>(std::clamp(mm * worth_per_mm, 0.0, most)) & ((1U << worth_bits) - 1);
        }
        double worth_mm() const { return worth / worth_per_mm; }
    };
    static_assert(sizeof(Near) == 12);
    // How far motors can have turned after more and more ticks: from rest, and more by what a speed adds of
    // itself. Arrays, so that all of them are compared at once.
    struct Reaches {
        static constexpr size_t count = 16;
        using Row = std::array<double, count>;
        static constexpr Row ticks = {4,  8,  12, 16, 20, 24,  28,  32,
                                      40, 48, 64, 80, 96, 128, 192, longest_ticks};
        Row from_rest_rad{}, coasting_ticks{};
    };
    // Of one arm or two together, what makes a bound of it.
    struct Movers {
        double lever_mm = 0.0, speed_mm = 0.0, pushed_mm = 0.0;
    };
    double bound_mm(const Movers &m, size_t k) const {
        return reaches_.from_rest_rad[k] * m.lever_mm + reaches_.coasting_ticks[k] * m.speed_mm +
               Reaches::ticks[k] * m.pushed_mm;
    }
    // Those of positioner i.
    std::span<Near> near(size_t i) {
        return {near_.data() + first_near_[i], near_.data() + first_near_[i + 1]};
    }
    struct Levers { // mm of an arm for a rad of its motors
        double alpha = 0.0, beta = 0.0;
    };
    struct Touched { // the other body of a contact
        uint32_t number;
        Segment line;
        double apart_mm;  // centre lines nearer than this touch
        double spring_mm; // how far it springs back when let go
        const Pose *pose; // of an arm
    };
    struct Place { // of a contact: its number as in Contact, and the share of a Newton step it takes
        int number;
        double share;
        Closest closest;
    };
    double reach_mm(size_t i) const;
    Levers longest_mm(size_t i) const;
    bool allow_speed(const SpeedBound &speed);
    void find_reaches();
    // That a point of an arm moves at most in a tick while another pushes it: as fast as that one, and by its
    // own motors.
    double pushed_mm(size_t i) const { return 2.0 * limit_rad_ * (levers_mm_[i].alpha + levers_mm_[i].beta); }
    void add_mover(Movers &movers, size_t i, const Travel &now) const;
    uint64_t free_ticks(const Movers &movers, double apart_mm) const;
    void hasten(size_t i, size_t other, uint64_t tick);
    void add_near(size_t number);
    void find_neighbours();
    double softness_mm_per_N(size_t i, const Pose &pose, const ContactPoint &m) const;
    Touched body(uint32_t number, const std::vector<Pose> &poses) const;
    double loose_mm(uint32_t other) const;
    double touch(Look &look, const Touched &body) const;
    double apart_mm(Look &look, Near &near, double travelled_mm) const;
    void plan_look(const Look &look, Near &near, double apart_mm) const;
    void press(Look &look, const Touched &body, const Place &at) const;

    std::vector<Arm> arms_;
    std::vector<Obstacle> obstacles_;
    Body body_;
    struct Compliance {
        double rad_per_Nm[2];
    };
    std::vector<Compliance> compliances_; // of the arms
    double scale_ = 1.0;                  // of every bound
    // the most that a motor turns in a tick, and the time constant with which any can come to that
    double limit_rad_ = 0.0, decay_ticks_ = 1e9;
    Reaches reaches_;
    double loose_mm_ = 0.0; // by which a point of any arm may be off what its motors say
    std::vector<Levers> levers_mm_;
    std::vector<Near> near_;           // of all, one after the other
    std::vector<uint32_t> first_near_; // of each, and one more
    // tick before which nothing can touch positioner i; and before which nothing asks where it is
    std::vector<uint64_t> next_look_, next_exact_;
};

} // namespace fl::twin
