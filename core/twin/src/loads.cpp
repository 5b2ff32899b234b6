#include "fiberloom/twin/loads.hpp"

#include <algorithm>
#include <cmath>

namespace fl::twin {
namespace {

// z of (moment, turned by the direction of its arm) x gravity: what gravity turns an axis with.
double pull(const AxisLoad &load, double direction_rad, Gravity g) {
    if (g.x == 0.0 && g.y == 0.0) return 0.0; // overhead: no sine is needed to know
    const double c = std::cos(direction_rad), s = std::sin(direction_rad);
    const double x = c * load.moment_x - s * load.moment_y, y = s * load.moment_x + c * load.moment_y;
    return x * g.y - y * g.x;
}

} // namespace

// A spring that slips: it pulls back by as much as friction holds, whatever came before a turn of fibre_slip.
void ArmLoads::Bundle::turn(double from_rad, double to_rad) {
    const double stretched = held_Nm - load.fibre_friction / load.fibre_slip * (to_rad - from_rad);
    held_Nm = std::clamp(stretched, -load.fibre_friction, load.fibre_friction);
}

double ArmLoads::Bundle::torque_Nm(double at_rad) const {
    return held_Nm - load.fibre_rate * (at_rad - load.fibre_free);
}

ArmLoads::ArmLoads(const AxisLoad &alpha, const AxisLoad &beta, Angles zero, Angles at)
    : alpha_{alpha}, beta_{beta}, zero_(zero), at_(at) {}

bool ArmLoads::turn(Angles to) {
    if (follow(to)) return false;
    alpha_.turn(at_.alpha_rad, to.alpha_rad);
    beta_.turn(at_.beta_rad, to.beta_rad);
    at_ = to;
    return true;
}

LoadTorque ArmLoads::torque(Gravity gravity) const {
    const double along_alpha = at_.alpha_rad + zero_.alpha_rad;
    const double along_beta = along_alpha + at_.beta_rad + zero_.beta_rad;
    const double of_beta = pull(beta_.load, along_beta, gravity);
    // the beta arm turns with alpha too
    return {pull(alpha_.load, along_alpha, gravity) + of_beta + alpha_.torque_Nm(at_.alpha_rad),
            of_beta + beta_.torque_Nm(at_.beta_rad)};
}

LoadTorque ArmLoads::range(Angles turns, Gravity gravity) const {
    const double g = std::hypot(gravity.x, gravity.y);
    const auto of_mass = [g](const AxisLoad &load) {
        return 2.0 * g * std::hypot(load.moment_x, load.moment_y);
    };
    const auto of_fibres = [](const AxisLoad &load, double turn_rad) {
        return 2.0 * std::abs(load.fibre_friction) + std::abs(load.fibre_rate) * turn_rad;
    };
    const double of_beta = of_mass(beta_.load);
    return {of_mass(alpha_.load) + of_beta + of_fibres(alpha_.load, turns.alpha_rad),
            of_beta + of_fibres(beta_.load, turns.beta_rad)};
}

} // namespace fl::twin
