// Arms that touch push each other: contact forces between beta arms, and between beta arms and what
// does not move (fiducials, guide cameras).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"
#include "fiberloom/twin/axis_group.hpp"

namespace fl::twin {

// Arms exchange where they are at these ticks, and those that touch at every tick. An arm's tip moves 9 um
// between two of them at 2000 rpm.
inline constexpr uint64_t sync_ticks = 4;

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

// How one arm gives way: per axis, rad per Nm, the fastest it can turn, and the most for a way of its gear.
struct Give {
    double compliance_rad_per_Nm[2] = {0.0, 0.0};
    double speed_limit_rad_s[2] = {0.0, 0.0}; // of the output
    double output_per_gear[2] = {0.0, 0.0};
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
    // One row of `gives` for each arm. @pre arms and gives have the same size.
    Neighbours(std::vector<Arm> arms, std::vector<Obstacle> obstacles, Body body, std::vector<Give> gives);

    // Positioner i at these angles; rigid: where it would spring to.
    Pose pose(size_t i, Angles deflected, Angles rigid) const;

    // What push() would find at tick 0 of pairs that do not touch then: the first tick has less to do, and
    // the answers stay the same to the bit. Once, before any push(). poses: as push() is given them at tick
    // 0.
    void plan_first_looks(const std::vector<Pose> &poses);

    // Torque on positioner i by all that it touches. Far neighbours are left out until they could have
    // come near: the answer does not depend on it. `contacts` are those of the last sync point, and
    // then those of this. travels_mm: of all positioners at the last sync point, see travel_mm. Any thread,
    // one call per positioner at a time.
    Push push(size_t i, const std::vector<Pose> &poses, const std::vector<double> &travels_mm, uint64_t tick,
              std::vector<Contact> &contacts);

    // Whether something could touch positioner i at this tick, as far as speeds tell.
    bool due(size_t i, uint64_t tick) const { return tick >= next_look_[i]; }
    // The first tick at which something could touch something.
    uint64_t next_due() const;
    // Whether push() needs the pose of positioner i at this tick: two look at each other at the same ticks,
    // and only if they have travelled as far as they were apart, but for a sync point.
    bool shown(size_t i, uint64_t tick) const { return tick >= next_exact_[i]; }

    // How far a point of arm i has come at most when its gears have turned so far, motor rad. Sums of it,
    // sync point by sync point, are the travels of push().
    double travel_mm(size_t i, double alpha_rad, double beta_rad) const {
        return levers_mm_[i].alpha * alpha_rad + levers_mm_[i].beta * beta_rad;
    }
    // The farthest that it can come from one sync point to the next.
    double farthest_mm(size_t i) const { return most_mm_[i] * static_cast<double>(sync_ticks); }

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
        const std::vector<Pose> &poses;
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
    // Those of positioner i.
    std::span<Near> near(size_t i) {
        return {near_.data() + first_near_[i], near_.data() + first_near_[i + 1]};
    }
    struct Levers { // mm of an arm for a motor rad of its gears
        double alpha, beta;
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
    void find_speeds(const std::vector<Give> &gives);
    void add_near(size_t number);
    void find_neighbours();
    double softness_mm_per_N(size_t i, const Pose &pose, const ContactPoint &m) const;
    Touched body(uint32_t number, const std::vector<Pose> &poses) const;
    double touch(Look &look, const Touched &body) const;
    double apart_mm(Look &look, Near &near, double travelled_mm) const;
    void plan_look(const Look &look, Near &near, double apart_mm, uint64_t tick) const;
    void press(Look &look, const Touched &body, const Place &at) const;

    std::vector<Arm> arms_;
    std::vector<Obstacle> obstacles_;
    Body body_;
    struct Compliance {
        double rad_per_Nm[2];
    };
    std::vector<Compliance> compliances_; // of the arms
    std::vector<double> most_mm_;         // that a point of an arm moves in a tick
    std::vector<Near> near_;              // of all, one after the other
    std::vector<uint32_t> first_near_;    // of each, and one more
    std::vector<Levers> levers_mm_;
    // tick before which nothing can touch positioner i; and before which nothing asks where it is
    std::vector<uint64_t> next_look_, next_exact_;
};

} // namespace fl::twin
