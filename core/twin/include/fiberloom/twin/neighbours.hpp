// Arms that touch push each other: contact forces between beta arms, and between beta arms and what
// does not move (fiducials, guide cameras).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"

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

// How one arm gives way: per axis, rad per Nm, and the fastest it can turn.
struct Give {
    double compliance_rad_per_Nm[2] = {0.0, 0.0};
    double speed_limit_rad_s[2] = {0.0, 0.0}; // of the output
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

    // Torque on positioner i by all that it touches. Far neighbours are left out until they could have
    // come near: the answer does not depend on it. `contacts` are those of the last sync point, and
    // then those of this. Any thread, one call per positioner at a time.
    Push push(size_t i, const std::vector<Pose> &poses, uint64_t tick, std::vector<Contact> &contacts);

    // Whether something could touch positioner i at this tick. Until then nobody asks where it is: two look
    // at each other at the same ticks.
    bool due(size_t i, uint64_t tick) const { return tick >= next_look_[i]; }

    // Memory of one positioner, with the longest list of neighbours.
    size_t bytes_per_positioner() const;
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
    struct Near {
        uint32_t number;        // as in Touch
        uint64_t next_look = 0; // tick before which the two cannot touch
    };
    struct Touched { // the other body of a contact
        uint32_t number;
        Segment line;
        double apart_mm;  // centre lines nearer than this touch
        double spring_mm; // how far it springs back when let go
        double speed_mm_s;
        const Pose *pose; // of an arm
    };
    struct Place { // of a contact: its number as in Contact, and the share of a Newton step it takes
        int number;
        double share;
        Closest closest;
    };
    double reach_mm(size_t i) const;
    void find_speeds();
    void find_neighbours();
    double softness_mm_per_N(size_t i, const Pose &pose, const ContactPoint &m) const;
    Touched body(uint32_t number, const std::vector<Pose> &poses) const;
    double touch(Look &look, const Touched &body) const;
    void press(Look &look, const Touched &body, const Place &at) const;

    std::vector<Arm> arms_;
    std::vector<Obstacle> obstacles_;
    Body body_;
    std::vector<Give> gives_;
    std::vector<double> speed_mm_s_; // at which a point of an arm moves at most
    std::vector<std::vector<Near>> near_;
    std::vector<uint64_t> next_look_; // tick before which nothing can touch positioner i
};

} // namespace fl::twin
