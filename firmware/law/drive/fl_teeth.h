/* Whether the motor's teeth touch the gear's, from the measured angle and the backlash (Kronig 2020, Eq. 3b
 * with its sign corrected, Eq. 7): the gear is not back-drivable, so it stands where the motor left it.
 *
 *   gear <= rotor <= gear + B(gear)      touching below at the left end, above at the right one
 *
 * B = T+ - T- in motor counts: mean, three slow waves an output turn and the wave of the tooth pairings. What
 * the rotor does moves the gear's place by clamping; after a way longer than B it is right whatever it was.
 */
#ifndef FL_TEETH_H
#define FL_TEETH_H

#include "fl_math.h"

typedef struct fl_teeth_config {
    float mean_cnt, once_cnt, twice_cnt, thrice_cnt, pairing_cnt; /* amplitudes of sin(m theta + phase) */
    int32_t once_phase_cnt, twice_phase_cnt, thrice_phase_cnt, pairing_phase_cnt;
    int32_t pairings; /* an output turn */
} fl_teeth_config_t;

typedef struct fl_teeth_state {
    int32_t gear_cnt; /* the rotor angle at which the teeth touch below */
    int32_t known;    /* 0: nothing is, since power-up */
    int32_t touching; /* 1 while the motor is known to push the gear; 0 where no backlash is given */
} fl_teeth_state_t;

typedef struct fl_gap {
    int32_t below_cnt, above_cnt; /* what is left of the gap on either side of the rotor, >= 0 */
} fl_gap_t;

/* sin(m theta + phase) of the output angle theta, 2^30 counts a turn. */
static inline float fl_teeth_wave(int32_t m, int32_t position_cnt, int32_t phase_cnt) {
    const int32_t turned = (int32_t)((uint32_t)m * (uint32_t)position_cnt) >> 10;
    return fl_sin_cnt(fl_add_i32(turned, phase_cnt));
}

/* B at a position, counts, not below zero. */
static inline int32_t fl_teeth_backlash(const fl_teeth_config_t *cfg, int32_t position_cnt) {
    const float slow = cfg->once_cnt * fl_teeth_wave(1, position_cnt, cfg->once_phase_cnt) +
                       cfg->twice_cnt * fl_teeth_wave(2, position_cnt, cfg->twice_phase_cnt) +
                       cfg->thrice_cnt * fl_teeth_wave(3, position_cnt, cfg->thrice_phase_cnt);
    const float fast = cfg->pairing_cnt * fl_teeth_wave(cfg->pairings, position_cnt, cfg->pairing_phase_cnt);
    return (int32_t)fl_max(cfg->mean_cnt + slow + fast, 0.0f);
}

/* The gap around the rotor, measured now; zero_cnt: position - rotor angle. Unknown, the rotor is taken to be
 * in its middle.
 * @pre less than 2^31 counts since the last call */
static inline fl_gap_t fl_teeth_step(const fl_teeth_config_t *cfg, fl_teeth_state_t *st, int32_t rotor_cnt,
                                     int32_t zero_cnt) {
    const int32_t before_cnt = st->known ? st->gear_cnt : rotor_cnt;
    const int32_t backlash = fl_teeth_backlash(cfg, fl_add_i32(before_cnt, zero_cnt));
    const int32_t way = st->known ? fl_sub_i32(rotor_cnt, st->gear_cnt) : backlash / 2;
    const int32_t below = way < 0 ? 0 : way > backlash ? backlash : way;
    st->gear_cnt = fl_sub_i32(rotor_cnt, below);
    st->known = 1;
    const fl_gap_t out = {below, backlash - below};
    return out;
}

#endif
