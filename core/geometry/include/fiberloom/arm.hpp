// Kinematics of one alpha-beta positioner: Kronig 2020, Eq. 1 and Eq. 2, in the focal plane.
//
// Frames, signs and zeros: docs/conventions.md. Lengths in mm, angles in rad, counter-clockwise
// positive. beta = 0 is the stretched arm, beta = pi the folded one.
#pragma once

#include <array>

namespace fl {

// A place or a direction in a plane; mm where nothing else is said.
struct Vec2 {
    double x = 0.0;
    double y = 0.0;
};

// Output angles of the two axes of a positioner, rad.
struct Angles {
    double alpha_rad = 0.0;
    double beta_rad = 0.0;
};

// The arm of one positioner: r_center, l_a, alpha_off of Eq. 1. The orientation of the positioner's
// own frame and its alpha zero add up to one angle; beta has a zero of its own (folded into beta in
// the paper). l_b belongs to the point on the beta arm, not to the arm.
struct Arm {
    Vec2 centre_mm;
    double l_alpha_mm = 0.0;
    double alpha_off_rad = 0.0; // orientation of the positioner + zero of its alpha axis
    double beta_off_rad = 0.0;
};

// The angles that the axes may have, rad. @pre each minimum is not above its maximum.
struct Limits {
    double alpha_min_rad, alpha_max_rad, beta_min_rad, beta_max_rad;
};

// All arm angles that put a point on a target, right-handed elbow (beta in [0, pi]) first, then by
// rising alpha. gap_mm tells how far the target lies outside the annulus of the arms (0 inside);
// count = 0 with gap_mm = 0 means that only the axis limits exclude it.
struct Solutions {
    static constexpr int max_count = 4; // two elbows, and alpha ranges up to two turns
    std::array<Angles, max_count> angles{};
    int count = 0;
    double gap_mm = 0.0;
};

// A target nearer to the edge of the annulus than this is on the edge: rounding must not decide.
inline constexpr double edge_tolerance_mm = 1e-9;
inline constexpr double limit_tolerance_rad = 1e-9;

// Where a point of the beta arm (x, y of its frame, mm) is in the focal plane, mm. Eq. 1. Any angles.
Vec2 forward(const Arm &arm, Vec2 point_mm, Angles angles);

// Both elbow branches of Eq. 2 that lie inside the limits, for the point of the beta arm and its target in
// the focal plane, mm. More than Solutions::max_count solutions are left out: the limits of alpha span more
// than two turns then.
Solutions inverse(const Arm &arm, Vec2 point_mm, Vec2 target_mm, const Limits &limits);

// d(x, y) / d(alpha, beta) of `forward` in mm/rad, row-major: {dx/da, dx/db, dy/da, dy/db}.
std::array<double, 4> jacobian(const Arm &arm, Vec2 point_mm, Angles angles);

// The beta axis, where the two arms meet, mm in the focal plane.
Vec2 elbow(const Arm &arm, double alpha_rad);

} // namespace fl
