/* Hall calibration: offsets, amplitudes and phase of the two channels from samples over some turns.
 *
 * The samples lie on an ellipse whatever the rotor's speed, so no angle is needed. A first turn finds
 * the range, which centres and scales the samples; then p a^2 + q b^2 + r ab + s a + t b = 1 is fitted
 * and read exactly: centred on c, with x = a/amplitude_a = sin(theta) and y = cos(theta + phase),
 *   x^2 + y^2 + 2 x y sin(phase) = cos(phase)^2.
 */
#ifndef FL_HALL_FIT_H
#define FL_HALL_FIT_H

#include "fl_linear.h"

typedef struct fl_hall_fit {
    uint16_t min_cnt[2], max_cnt[2];
    uint32_t samples;
    fl_normal_t normal;
} fl_hall_fit_t;

typedef struct fl_hall_shape {
    float offset_cnt[2], amplitude_cnt[2], phase_rad;
    float residual_rad; /* rms, of the radius in units of the amplitude */
} fl_hall_shape_t;

/* Forgets the range and all samples. */
static inline void fl_hall_fit_reset(fl_hall_fit_t *f) {
    const fl_hall_fit_t empty = {{UINT16_MAX, UINT16_MAX}, {0, 0}, 0, {{{0}}}};
    *f = empty;
}

/* First turn: widens the range by a sample of channels A and B, counts. */
static inline void fl_hall_fit_range(fl_hall_fit_t *f, const uint16_t adc_cnt[2]) {
    for (int i = 0; i < 2; ++i) {
        if (adc_cnt[i] < f->min_cnt[i]) f->min_cnt[i] = adc_cnt[i];
        if (adc_cnt[i] > f->max_cnt[i]) f->max_cnt[i] = adc_cnt[i];
    }
}

/* Middle of the range of channel i (0 = A, 1 = B), counts.
 * @pre a sample in the range */
static inline float fl_hall_fit_centre(const fl_hall_fit_t *f, int i) {
    return 0.5f * ((float)f->min_cnt[i] + (float)f->max_cnt[i]);
}
/* Half the width of the range of channel i, counts.
 * @pre as above */
static inline float fl_hall_fit_scale(const fl_hall_fit_t *f, int i) {
    return 0.5f * ((float)f->max_cnt[i] - (float)f->min_cnt[i]);
}

/* After the range is known. */
static inline void fl_hall_fit_add(fl_hall_fit_t *f, const uint16_t adc_cnt[2]) {
    const float a = ((float)adc_cnt[0] - fl_hall_fit_centre(f, 0)) / fl_max(fl_hall_fit_scale(f, 0), 1.0f);
    const float b = ((float)adc_cnt[1] - fl_hall_fit_centre(f, 1)) / fl_max(fl_hall_fit_scale(f, 1), 1.0f);
    const float basis[FL_FIT_SIZE] = {a * a, b * b, a * b, a, b};
    fl_normal_add(&f->normal, FL_FIT_SIZE, basis, 1.0f);
    ++f->samples;
}

/* False when the samples are no ellipse around the middle of their range, or too small a one. */
static inline bool fl_hall_fit_solve(fl_hall_fit_t *f, fl_hall_shape_t *out) {
    float k[FL_FIT_SIZE], explained;
    if (f->samples < 100 || !fl_normal_solve(&f->normal, FL_FIT_SIZE, k, &explained)) return false;
    const float p = k[0], q = k[1], r = k[2], s = k[3], t = k[4];
    const float det = 4.0f * p * q - r * r;
    if (!(p > 0.0f && q > 0.0f && det > 0.0f)) return false;
    const float a0 = (r * t - 2.0f * q * s) / det, b0 = (r * s - 2.0f * p * t) / det;
    const float size = 1.0f + p * a0 * a0 + r * a0 * b0 + q * b0 * b0;
    const float sin_phase = r / (2.0f * fl_sqrt(p * q));
    const float cos2 = 1.0f - sin_phase * sin_phase;
    const float centre[2] = {a0, b0};
    const float radius[2] = {fl_sqrt(size / (p * cos2)), fl_sqrt(size / (q * cos2))};
    for (int i = 0; i < 2; ++i) {
        out->offset_cnt[i] = fl_hall_fit_centre(f, i) + fl_hall_fit_scale(f, i) * centre[i];
        out->amplitude_cnt[i] = fl_hall_fit_scale(f, i) * radius[i];
    }
    const float samples = (float)f->samples;
    out->residual_rad = 0.5f * fl_sqrt(fl_max(samples - explained, 0.0f) / samples);
    const int32_t phase_cnt = fl_fold_cnt(fl_atan2_cnt(sin_phase, fl_sqrt(cos2)));
    out->phase_rad = (float)phase_cnt * FL_RAD_PER_CNT;
    return out->amplitude_cnt[0] >= 100.0f && out->amplitude_cnt[1] >= 100.0f;
}

#endif
