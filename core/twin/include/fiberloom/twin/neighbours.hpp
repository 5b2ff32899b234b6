// Arms that touch push each other: contact forces between beta arms, and between beta arms and what
// stands fast (fiducials, guide cameras).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "fiberloom/arm.hpp"
#include "fiberloom/distance.hpp"

namespace fl::twin {

struct Obstacle { // a capsule that stands fast; a disc when both ends coincide
    Segment centre_line_mm;
    double radius_mm = 0.0;
};

struct Body { // the beta arm's capsule: what is there, not the buffer that planning keeps
    double from_mm = 0.0, to_mm = 14.7, radius_mm = 1.5;
};

// How one arm gives way: per axis, rad per Nm, and the fastest it can turn.
struct Give {
    double compliance_rad_per_Nm[2] = {0.0, 0.0};
    double speed_limit_rad_s[2] = {0.0, 0.0}; // of the output
};

struct Touch {
    uint64_t tick;
    uint32_t first, second; // positioners; second = positioner_count + k is obstacle k
};

struct Push {
    double torque_Nm[2] = {0.0, 0.0}; // alpha, beta
};

class Neighbours {
  public:
    Neighbours() = default;
    Neighbours(std::vector<Arm> arms, std::vector<Obstacle> obstacles, Body body, std::vector<Give> gives);

    // Torque on positioner i by all that it touches, from where everybody's gears are. Far neighbours are
    // left out until they could have come near: the answer does not depend on it. `touched` gets every
    // other body in contact. Any thread, one call per positioner at a time.
    Push push(size_t i, const std::vector<Angles> &angles, uint64_t tick, std::vector<uint32_t> &touched);

    size_t positioner_count() const { return arms_.size(); }

  private:
    struct Contact {
        Vec2 point_mm, normal; // on the arm, unit vector that pushes it away
        double depth_mm;
    };
    double reach_mm(size_t i) const;
    double approach_speed_mm_s(size_t i) const;
    void find_neighbours();
    Segment segment(size_t i, const Angles &angles) const;
    double softness_mm_per_N(size_t i, const Angles &angles, const Contact &c) const;
    void add(Push &push, size_t i, const Angles &angles, const Contact &c, double other_mm_per_N) const;
    double meet_arm(size_t i, size_t j, const std::vector<Angles> &angles, const Segment &mine, Push &push,
                    std::vector<uint32_t> &touched) const;
    double meet_obstacle(size_t i, size_t k, const Angles &angles, const Segment &mine, Push &push,
                         std::vector<uint32_t> &touched) const;

    std::vector<Arm> arms_;
    std::vector<Obstacle> obstacles_;
    Body body_;
    std::vector<Give> gives_;
    std::vector<std::vector<uint32_t>> near_arms_, near_obstacles_;
    std::vector<uint64_t> next_look_; // tick before which nothing can touch positioner i
};

} // namespace fl::twin
