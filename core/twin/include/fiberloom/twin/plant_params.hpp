// The parameters of one true axis, each listed once: name, unit, minimum, maximum, default, meaning.
// The C++ struct, the numpy dtype and the table in docs/twin.md are made from this list. SI, radians.
//
// Defaults are the alpha axis of an SDSS-V positioner. Sizes: inertia Kronig 2020 Fig. 14; Coulomb,
// drag and peak torque consistent with Fig. 12 and 14 (derived, EQUATIONS in docs/twin.md); stiffness
// Fig. 13. How torque splits between motor and gear, and drag between back-EMF and grease, is assumed.
#pragma once

namespace fl::twin {

// clang-format off
#define FL_PLANT_PARAMS(X)                                                                                    \
    X(inertia_motor, "kg m^2", 1e-13, 1e-3, 3.4e-9, "rotor")                                                  \
    X(inertia_gear, "kg m^2", 0, 1e-3, 1e-10, "gear and arm, at the motor: joins the rotor in contact")       \
    X(coulomb_motor, "Nm", 0, 1, 1e-6, "Coulomb friction of the rotor's own bearings")                        \
    X(coulomb_gear, "Nm", 0, 1, 1.9e-5, "Coulomb friction of the gear at the motor, Eq. 8")                   \
    X(viscous_motor, "Nm s/rad", 0, 1, 5e-8, "viscous friction of the rotor")                                 \
    X(viscous_gear, "Nm s/rad", 0, 1, 2.5e-7, "viscous friction of the gear at the motor, Eq. 8")             \
    X(flux_linkage, "Wb", 1e-6, 1, 1.031e-2, "lambda_PM, Eq. 15")                                             \
    X(coil_resistance, "Ohm", 1e-3, 1e6, 319, "R of each delta coil, Eq. 14")                                 \
    X(supply, "V", 0, 60, 12, "u_dc of the bridges")                                                          \
    X(pwm_steps, "1", 1, 1048576, 4000, "duties are multiples of 1/pwm_steps")                                \
    X(cogging_2, "Nm", 0, 1, 1e-5, "amplitude of the cogging, two cycles a motor turn, Fig. 11")              \
    X(cogging_2_phase, "rad", -7, 7, 0, "resistance = cogging_2 sin(2 theta + phase)")                        \
    X(cogging_4, "Nm", 0, 1, 8e-7, "amplitude of its second harmonic")                                        \
    X(cogging_4_phase, "rad", -7, 7, 0, "resistance = cogging_4 sin(4 theta + phase)")                        \
    X(gear_ratio, "1", 1, 1e6, 1024, "n, motor turns per output turn")                                        \
    X(spring_rate, "Nm/rad", 0, 100, 9.44e-4, "torsion spring at the output, Eq. 3a divided by n")            \
    X(spring_free, "rad", -100, 100, 8.68, "theta_ref: output angle at which the spring is relaxed")          \
    X(stiffness, "Nm/rad", 1e-6, 1e6, 19.31, "k of Eq. 5a: 337 mNm/deg")                                      \
    X(seat_rms, "rad", 0, 1e-2, 0, "how far the arm comes to rest from where it rested last time, output angle")      \
    X(stop_min, "rad", -100, 100, -0.0873, "lower hard stop, output angle")                                   \
    X(stop_max, "rad", -100, 100, 6.3705, "upper hard stop, output angle")                                    \
    X(stop_stiffness, "Nm/rad", 1e-6, 1e6, 200, "of the stop itself, in series with the gear")                \
    X(hall_offset_a, "cnt", 0, 4095, 2048, "centre of hall channel A (sine)")                                 \
    X(hall_offset_b, "cnt", 0, 4095, 2048, "centre of hall channel B (cosine)")                               \
    X(hall_amplitude_a, "cnt", 0, 2047, 1500, "amplitude of channel A")                                       \
    X(hall_amplitude_b, "cnt", 0, 2047, 1500, "amplitude of channel B")                                       \
    X(hall_phase, "rad", -0.5, 0.5, 0, "B = offset + amplitude cos(theta + phase)")                           \
    X(hall_noise, "cnt", 0, 200, 3, "rms noise of a sample of either channel")
// clang-format on

// The parameters of one axis, SI and rad.
struct PlantParams {
#define X(name, unit, min, max, def, doc) double name = def;
    FL_PLANT_PARAMS(X)
#undef X
};

// One line of the list.
struct PlantParamInfo {
    const char *name, *unit;
    double min, max, def;
    const char *doc;
};

inline constexpr PlantParamInfo plant_param_infos[] = {
#define X(name, unit, min, max, def, doc) {#name, unit, min, max, def, doc},
    FL_PLANT_PARAMS(X)
#undef X
};
inline constexpr int plant_param_count = sizeof plant_param_infos / sizeof *plant_param_infos;
static_assert(sizeof(PlantParams) == plant_param_count * sizeof(double));

// Of a rotor's speed, whatever its bridge does and whatever acts on its gear: one at w0 is at most at
// limit - (limit - |w0|) exp(-t / time constant) after t, and none ever goes faster than the limit.
struct SpeedBound {
    double limit_rad_s = 0.0, time_constant_s = 1.0;
};
SpeedBound speed_bound(const PlantParams &params);

} // namespace fl::twin
