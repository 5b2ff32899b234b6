// What pulls at the arms of a positioner beside its springs: gravity, and the bundle of its fibres. N, m,
// rad.
#pragma once

#include <cstdint>

#include "fiberloom/arm.hpp"

namespace fl::twin {

// Loads follow the arms at these ticks. In 16 ms an arm turns by 3.3 mrad at 2000 rpm of its motor; by as
// large a share of what a mass pulls with does the pull change.
inline constexpr uint64_t load_ticks = 32;

// Of one axis. The moment is the mass that the axis carries times where its centre is, in the frame of its
// own arm: x along it, y to its left. What hangs on the elbow belongs to alpha's.
struct AxisLoad {
    double moment_x = 0.0, moment_y = 0.0; // kg m
    double fibre_rate = 0.0;               // Nm/rad: by which the bundle's pull grows with the angle
    double fibre_free = 0.0;               // rad: output angle at which it does not pull
    double fibre_friction = 0.0;           // Nm: the most by which it pulls back after a turn, its hysteresis
    double fibre_slip = 1.0;               // rad: of a turn after which it pulls so
};

// Acceleration along the focal plane, m/s^2.
struct Gravity {
    double x = 0.0, y = 0.0;
};

struct LoadTorque {
    double alpha_Nm = 0.0, beta_Nm = 0.0;
};

// Both axes of a positioner. Angles are those of the arms at rest, without what bends them: 1e-4 rad, by
// which no torque changes by more than as large a part of it.
class ArmLoads {
  public:
    // zero: direction of alpha = 0 in the focal plane, and beta's; at: where the arms are, the bundle at ease
    ArmLoads(const AxisLoad &alpha, const AxisLoad &beta, Angles zero, Angles at);

    // The arms have turned to there; false where they have not.
    bool turn(Angles to);
    // Whether the loads are those of arms that are there.
    bool follow(Angles at) const { return at.alpha_rad == at_.alpha_rad && at.beta_rad == at_.beta_rad; }
    // Positive towards positive angles: -d/dangle of the potential -g.(sum of m r), and the bundle's.
    LoadTorque torque(Gravity gravity) const;
    // No two torques within such turns of the axes differ by more.
    LoadTorque range(Angles turns, Gravity gravity) const;

  private:
    struct Bundle {
        AxisLoad load;
        double held_Nm = 0.0; // by friction inside the bundle
        void turn(double from_rad, double to_rad);
        double torque_Nm(double at_rad) const;
    };
    Bundle alpha_, beta_;
    Angles zero_, at_;
};

} // namespace fl::twin
