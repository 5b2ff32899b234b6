/* The rotor angle from two analogue hall sensors.
 *
 * Channel A = offset_a + amplitude_a sin(theta), channel B = offset_b + amplitude_b cos(theta + phase),
 * in ADC counts. The unwrapped angle counts turns (Kronig 2020, Section 3.2): its lower 20 bits are
 * the angle within the turn, so it cannot drift. Good to half a turn between samples (60 000 rpm).
 */
#ifndef FL_HALL_H
#define FL_HALL_H

#include "fl_math.h"

typedef struct fl_hall_config {
    float offset_a_cnt, offset_b_cnt;
    float gain_a, gain_b; /* 1 / amplitude */
    float sec_phase, tan_phase;
} fl_hall_config_t;

typedef struct fl_hall_state {
    int32_t angle_cnt; /* unwrapped */
    bool seen;         /* the first sample counts no turn */
} fl_hall_state_t;

typedef struct fl_hall_out {
    fl_sincos_t rotor; /* about unit length; fl_commutate makes it so */
    int32_t angle_cnt;
} fl_hall_out_t;

/* Below this squared length of (sin, cos) the sensor is dead and the last angle is kept. */
#define FL_HALL_DEAD 0.1f

/* Sine and cosine of the rotor angle from the counts of channels A and B (0..FL_HALL_ADC_MAX); of unit length
 * as far as the calibration is right. */
static inline fl_sincos_t fl_hall_rotor(const fl_hall_config_t *cfg, float a_cnt, float b_cnt) {
    const float a = (a_cnt - cfg->offset_a_cnt) * cfg->gain_a;
    const float b = (b_cnt - cfg->offset_b_cnt) * cfg->gain_b;
    const fl_sincos_t out = {a, b * cfg->sec_phase + a * cfg->tan_phase};
    return out;
}

/* The same of a sample. */
static inline fl_sincos_t fl_hall_vector(const fl_hall_config_t *cfg, const uint16_t adc_cnt[2]) {
    return fl_hall_rotor(cfg, (float)adc_cnt[0], (float)adc_cnt[1]);
}

/* The unwrapped angle of a rotor that shows this sine and cosine. A dead sensor keeps the angle.
 * @pre less than half a motor turn since the sample before */
static inline fl_hall_out_t fl_hall_follow(fl_hall_state_t *st, fl_sincos_t rotor) {
    const bool alive = rotor.sin * rotor.sin + rotor.cos * rotor.cos > FL_HALL_DEAD;
    const int32_t angle = alive ? fl_atan2_cnt(rotor.sin, rotor.cos) : st->angle_cnt;
    if (st->seen)
        st->angle_cnt = fl_add_i32(st->angle_cnt, fl_fold_cnt(fl_sub_i32(angle, st->angle_cnt)));
    else
        st->angle_cnt = angle;
    st->seen = true;
    const fl_hall_out_t out = {rotor, st->angle_cnt};
    return out;
}

/* A sample of both channels: the rotor's unit vector and its unwrapped angle.
 * @pre less than half a motor turn since the sample before */
static inline fl_hall_out_t fl_hall_step(const fl_hall_config_t *cfg, fl_hall_state_t *st,
                                         const uint16_t adc_cnt[2]) {
    return fl_hall_follow(st, fl_hall_vector(cfg, adc_cnt));
}

#endif
