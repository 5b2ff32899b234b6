/* The parameters of one axis and of a positioner, each listed once: type, name, unit, minimum,
 * maximum, default, meaning. The C struct, the numpy dtype of the Python module and the manual are
 * all made from these lists. Motor-side quantities are SI; positions on the wire are counts
 * (2^30 per output turn, so 2^20 per motor turn at a gear of 1024).
 *
 * Defaults are those of the alpha axis of an SDSS-V positioner: J from Kronig 2020 Fig. 14, torques
 * consistent with Fig. 11, 12 and 14 (derived, see docs/theory). */
#ifndef FL_PARAMS_H
#define FL_PARAMS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* X(name, unit, min, max, default, meaning); every field is a float */
#define FL_AXIS_PARAMS(X)                                                                                    \
    X(hall_offset_a, "cnt", 0, 4095, 2048, "centre of hall channel A (sine)")                                \
    X(hall_offset_b, "cnt", 0, 4095, 2048, "centre of hall channel B (cosine)")                              \
    X(hall_amplitude_a, "cnt", 100, 2047, 1500, "amplitude of channel A")                                    \
    X(hall_amplitude_b, "cnt", 100, 2047, 1500, "amplitude of channel B")                                    \
    X(hall_phase, "rad", -0.5, 0.5, 0, "deviation of B from quadrature")                                     \
    X(u_dc, "V", 1, 48, 12, "supply of the bridges")                                                         \
    X(torque_per_volt, "Nm/V", 1e-8, 1, 4.2e-5, "Eq. 19: (3/2)(lambda/R)(sqrt(3)/2)")                        \
    X(inertia, "kg m^2", 1e-13, 1, 3.5e-9, "motor and gear, at the motor")                                   \
    X(drag, "Nm s/rad", 0, 1, 8e-7, "c_tot: viscous friction + back-EMF")                                    \
    X(coulomb, "Nm", 0, 1, 2e-5, "Coulomb friction of motor and gear")                                       \
    X(spring_torque, "Nm", -1, 1, 8e-6, "torsion spring at output angle 0, positive: resists -")             \
    X(spring_rate, "Nm/rad", -1, 1, -9e-10, "change of the spring torque per motor radian")                  \
    X(cogging_torque, "Nm", 0, 1, 1e-5, "amplitude, two cycles per motor turn")                              \
    X(cogging_phase, "rad", -7, 7, 0, "T_cog = amplitude sin(2 theta + phase), as met by the motor")         \
    X(k_p, "Nm/rad", 0, 10, 1.9e-5, "proportional gain, Eq. 21")                                             \
    X(k_i, "Nm/(rad s)", 0, 100, 4e-4, "integral gain")                                                      \
    X(integral_limit, "Nm", 0, 1, 1.5e-5, "anti-windup bound T_I_max, Eq. 23")                               \
    X(collision_torque, "Nm", 0, 1, 5.5e-5, "T_threshold, Eq. 22")                                           \
    X(speed_default, "rpm", 1, 6000, 2000, "of go-to moves, until SET_SPEED")                                \
    X(speed_max, "rpm", 1, 8000, 5000, "trajectories faster than this are refused")                          \
    X(acceleration, "rad/s^2", 1, 1e6, 840, "of go-to moves, at the motor")                                  \
    X(approach, "deg", 0, 3600, 840, "overshoot of the backlash-closing approach, motor degrees")            \
    X(position_min, "deg", -720, 720, -4, "output angle; commands beyond are refused")                       \
    X(position_max, "deg", -720, 720, 364, "")                                                               \
    X(settle_tolerance, "deg", 0, 90, 0.5, "motor angle at which a move has ended")                          \
    X(settle_time, "s", 0, 10, 0.02, "how long it must stay inside the tolerance")                           \
    X(settle_timeout, "s", 0, 10, 0.5, "a move ends at the latest so long after its profile")                \
    X(open_loop_voltage, "fraction", 0, 1, 1.0, "u_cmd/u_dc of the rotating field in open loop")             \
    X(holding_voltage, "fraction", 0, 1, 0, "u_cmd/u_dc at standstill; 0 switches off after a move")         \
    X(landing, "deg", 0, 360, 40, "the last motor degrees of a move are crept, so that nothing overshoots")  \
    X(landing_speed, "deg/s", 1, 10000, 50, "motor speed at its end")                                        \
    X(settle_gain, "1", 1, 20, 5, "factor on both gains while landing and settling")                         \
    X(datum_position, "deg", -720, 720, -4, "output angle of the hard stop the datum search meets")          \
    X(datum_speed, "rpm", 1, 6000, 300, "motor speed of the datum search")                                   \
    X(collision_speed_share, "1", 0, 1, 0.08,                                                                \
      "share of drag * speed added to T_threshold: until it is learnt")                                      \
    X(contact_torque, "Nm", 0, 1, 0,                                                                         \
      "resistance beyond the model that is a contact of the arm; 0: Eq. 22 alone")                           \
    X(touch_torque, "Nm", 0, 1, 0,                                                                           \
      "load that rises so far beyond its mean is a touch of the arm; 0: not watched")                        \
    X(drag_learning_time, "s", 0, 100, 0.1, "time in which the drag is learnt at 2000 rpm; 0: never")        \
    X(use_break_away, "1", 0, 1, 1, "share of the break-away feedforward, Eq. 21; 0 switches it off")        \
    X(use_speed, "1", 0, 1, 1, "share of the speed feedforward")                                             \
    X(use_inertia, "1", 0, 1, 1, "share of the inertia feedforward")                                         \
    X(host_timeout_ms, "ms", 0, 600000, 0,                                                                   \
      "a trajectory slows to a stop so long after the host's last frame; 0: it runs to its end")             \
    X(law, "1", 0, 1, 0, "0: Eq. 21; 1: state feedback, feedforward of the gear while the teeth touch")      \
    X(state_k_e, "Nm/rad", 0, 10, 9.9e-4, "law 1: feedback of the error")                                    \
    X(state_k_v, "Nm s/rad", 0, 1, 2.8e-6, "law 1: feedback of its rate")                                    \
    X(observer_pole, "1", 0, 0.99, 0.5, "law 1: three poles of the observer, a share per tick")              \
    X(gap_coulomb_share, "1", 0, 1, 0.05, "of coulomb: the rotor's alone, between the teeth")                \
    X(gap_drag_share, "1", 0, 1, 0.7, "of drag: back-EMF and the rotor's own friction")                      \
    X(backlash, "deg", 0, 3600, 0, "mean over the output turn, motor degrees; 0: the teeth always touch")    \
    X(backlash_1, "deg", 0, 3600, 0, "amplitude of sin(theta + phase) of the output angle")                  \
    X(backlash_1_phase, "rad", -7, 7, 0, "")                                                                 \
    X(backlash_2, "deg", 0, 3600, 0, "of sin(2 theta + phase)")                                              \
    X(backlash_2_phase, "rad", -7, 7, 0, "")                                                                 \
    X(backlash_3, "deg", 0, 3600, 0, "of sin(3 theta + phase)")                                              \
    X(backlash_3_phase, "rad", -7, 7, 0, "")                                                                 \
    X(backlash_teeth, "deg", 0, 3600, 0, "of sin(gear_teeth theta + phase)")                                 \
    X(backlash_teeth_phase, "rad", -7, 7, 0, "")                                                             \
    X(gear_teeth, "1", 0, 1000, 36, "tooth pairings of the last stage per output turn")

typedef struct fl_axis_params {
#define X(name, unit, min, max, def, doc) float name;
    FL_AXIS_PARAMS(X)
#undef X
} fl_axis_params_t;

#ifdef __cplusplus
}
#endif
#endif
