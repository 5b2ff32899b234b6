// What takes room of a positioner, as the search sees it.
//
// Most are one capsule on the axis of the beta arm: its centre line says where it is. All others have a shape
// of several limbs. Their centre line, from the beta axis along the beta arm, tells the pose of both arms,
// and all limbs are found from it; a capsule around the centre line, with them all in it, is looked at
// first.
#pragma once

#include "bodies/shape.hpp"
#include "fiberloom/planning.hpp"
#include "motion/index.hpp"
#include "motion/near_pairs.hpp"
#include "motion/swept_arm.hpp"
#include "motion/trig.hpp"

namespace fl::planning {

// The body of one positioner. Its centre line runs from x = from_mm to x = to_mm of the beta arm.
struct ArmBody {
    Arm arm;
    double from_mm = 0.0;
    double to_mm = 0.0;
    double extra_mm = 0.0; // its radius above the least one of all
    const Shape *shape = nullptr;
    double far_mm = 0.0;       // of any point on the beta arm from the beta axis
    double alpha_far_mm = 0.0; // of any point on the alpha arm from the alpha axis, in shapes

    // How far from the centre the centre line may be.
    double reach_mm() const { return std::abs(arm.l_alpha_mm) + far_mm; }
    // How far any point goes, at most, when alpha turns by one angle and both together by another, rad.
    double way_mm(double alpha_rad, double both_rad) const {
        return std::max(std::abs(arm.l_alpha_mm) * alpha_rad + far_mm * both_rad, alpha_far_mm * alpha_rad);
    }
    // The centre line for the turns of the alpha axis and of the beta axis against it.
    Segment line(Turn alpha, Turn beta) const {
        const Turn u = alpha * beta;
        const Vec2 e{arm.centre_mm.x + arm.l_alpha_mm * alpha.c, arm.centre_mm.y + arm.l_alpha_mm * alpha.s};
        return {{e.x + from_mm * u.c, e.y + from_mm * u.s}, {e.x + to_mm * u.c, e.y + to_mm * u.s}};
    }
    // At rest, where its centre line is.
    SweptArm resting(const Segment &at) const { return resting_arm(at, extra_mm, shape); }
};

// The bodies of all positioners. It is not copied: bodies point to its shapes.
class ArmBodies {
  public:
    explicit ArmBodies(const Bodies &bodies);
    ArmBodies(const ArmBodies &) = delete;
    ArmBodies &operator=(const ArmBodies &) = delete;

    const ArmBody &operator[](PositionerIndex i) const { return bodies_[i]; }
    // The least radius of all parts.
    double radius_mm() const { return radius_mm_; }
    // All of them, with the farthest points of their capsules beyond the least radius.
    List<Reach> reaches() const;

  private:
    static bool is_plain(const std::vector<Part> &parts);
    ArmBody plain(const Arm &arm, const Part &part) const;
    ArmBody shaped(const Arm &arm, const std::vector<Part> &parts, Shape &shape) const;

    double radius_mm_ = 0.0;
    List<ArmBody, PositionerIndex> bodies_;
    List<Shape> shapes_;
};

// How far an end of the arm leaves the chord of a quarter of a step, at most: both axes at full speed.
inline double step_bulge_mm(const ArmBody &body, double step_rad) {
    const double quarter = step_rad / quarters;
    return std::max(std::abs(body.arm.l_alpha_mm) + 4.0 * body.far_mm, body.alpha_far_mm) * quarter *
           quarter / 8.0;
}

} // namespace fl::planning
