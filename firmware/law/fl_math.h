/* Arithmetic the laws share: float32 only, no libm, the same bits on every machine.
 *
 * Motor angles are integers, FL_TURN_CNT per motor turn, so that turns can be counted without drift.
 */
#ifndef FL_MATH_H
#define FL_MATH_H

#include <stdbool.h>
#include <stdint.h>

#include "fl_tick.h"

#define FL_TURN_BITS 20
#define FL_TURN_CNT (1 << FL_TURN_BITS) /* counts per motor turn */
#define FL_TWO_PI 6.283185307179586     /* in double: the constants below are rounded once, by the compiler */
#define FL_RAD_PER_CNT ((float)(FL_TWO_PI / FL_TURN_CNT))
#define FL_CNT_PER_RAD ((float)(FL_TURN_CNT / FL_TWO_PI))
#define FL_CNT_PER_MOTOR_DEG ((float)(FL_TURN_CNT / 360.0))
#define FL_CNT_PER_OUTPUT_DEG ((float)((1 << 30) / 360.0))
#define FL_RAD_S_PER_CNT_TICK ((float)(FL_TWO_PI / FL_TURN_CNT * FL_TICK_HZ))
#define FL_CNT_TICK_PER_RPM ((float)(FL_TURN_CNT / (60.0 * FL_TICK_HZ)))
#define FL_CNT_TICK2_PER_RAD_S2 ((float)(FL_TURN_CNT / FL_TWO_PI / FL_TICK_HZ / FL_TICK_HZ))

typedef struct fl_sincos {
    float sin, cos;
} fl_sincos_t;

/* |x|.
 * @pre x != INT32_MIN */
static inline int32_t fl_abs_i32(int32_t x) { return x < 0 ? -x : x; }

/* The smaller of two. */
static inline int32_t fl_min_i32(int32_t a, int32_t b) { return a < b ? a : b; }

/* The larger of two. */
static inline int32_t fl_max_i32(int32_t a, int32_t b) { return a > b ? a : b; }
/* The larger; b where one is NaN. */
static inline float fl_max(float a, float b) { return a > b ? a : b; }
/* The smaller; b where one is NaN. */
static inline float fl_min(float a, float b) { return a < b ? a : b; }
/* x kept within lo..hi; lo where x is NaN.
 * @pre lo <= hi */
static inline float fl_clamp(float x, float lo, float hi) { return fl_min(fl_max(x, lo), hi); }

/* A processor that does one axis is faster where it leaves a second question out; a host that does many side
 * by side must not branch. The answers are the same. */
#ifdef FL_SIDE_BY_SIDE
#define FL_EITHER_ABOVE(a, limit_a, b, limit_b) (fl_max((a) - (limit_a), (b) - (limit_b)) > 0.0f)
#define FL_BOTH_REACH(a, limit_a, b, limit_b) (fl_min((a) - (limit_a), (b) - (limit_b)) >= 0.0f)
#else
#define FL_EITHER_ABOVE(a, limit_a, b, limit_b) ((a) > (limit_a) || (b) > (limit_b))
#define FL_BOTH_REACH(a, limit_a, b, limit_b) ((a) >= (limit_a) && (b) >= (limit_b))
#endif

/* Nothing that matters, and neither it nor what a gain makes of it is a subnormal float: these lose their
 * digits, and a processor takes a hundred times as long for them. */
#define FL_LEAST_NM 1e-30f
#define FL_LEAST_RAD 1e-18f /* a second, or s2 */

/* What fades to a share of itself each tick, down to least/(1 - share); x >= 0. Larger floats do not feel the
 * sum. */
static inline float fl_fade(float x, float share, float least) { return share * x + least; }

/* A lag of something in rad: x takes in a share of what it differs from the target by, and comes to rest
 * FL_LEAST_RAD/share above it. */
static inline float fl_follow(float x, float target, float share) {
    return x + (share * (target - x) + FL_LEAST_RAD);
}

/* |x|. */
static inline float fl_abs(float x) { return __builtin_fabsf(x); }

/* Sums and differences of positions wrap instead of overflowing. */
static inline int32_t fl_add_i32(int32_t a, int32_t b) { return (int32_t)((uint32_t)a + (uint32_t)b); }
/* The difference, likewise. */
static inline int32_t fl_sub_i32(int32_t a, int32_t b) { return (int32_t)((uint32_t)a - (uint32_t)b); }

/* An angle folded to half a motor turn either side of zero. */
static inline int32_t fl_fold_cnt(int32_t angle_cnt) {
    return (int32_t)((uint32_t)angle_cnt << (32 - FL_TURN_BITS)) >> (32 - FL_TURN_BITS);
}

/* Rounds to nearest, halves away from zero; |x| < 2^31. */
static inline int32_t fl_round_i32(float x) { return (int32_t)(x < 0.0f ? x - 0.5f : x + 0.5f); }

/* A selection by arithmetic: which octant an angle is in cannot be predicted. */
static inline int32_t fl_negate_if(bool negative, int32_t x) { return (x ^ -(int32_t)negative) + negative; }

/* Sine of a motor angle. Largest error 8e-7 (tests/firmware/test_fw_laws.py). */
static inline float fl_sin_cnt(int32_t angle_cnt) {
    const int32_t quarter = FL_TURN_CNT / 4;
    /* reflected to -90 .. 90 degrees, where the sine is the same */
    const int32_t acute = quarter - fl_abs_i32(fl_fold_cnt(fl_sub_i32(angle_cnt, quarter)));
    const float x = (float)acute * FL_RAD_PER_CNT;
    const float z = x * x;
    /* odd minimax on [0, pi/2], fitted in float64: 5.9e-7 */
    return x * ((0.999996616f - 0.166648284f * z) + (0.00830632516f - 0.000183636522f * z) * (z * z));
}

/* Sine and cosine of a motor angle; errors as of fl_sin_cnt. */
static inline fl_sincos_t fl_sincos_cnt(int32_t angle_cnt) {
    const fl_sincos_t out = {fl_sin_cnt(angle_cnt), fl_sin_cnt(fl_add_i32(angle_cnt, FL_TURN_CNT / 4))};
    return out;
}

/* The angle of (cos, sin), 0 .. FL_TURN_CNT - 1, rounded to a count; (0, 0) gives 0. Largest error
 * 1.1 counts (4e-4 motor degrees), of which 0.5 is rounding. */
static inline int32_t fl_atan2_cnt(float s, float c) {
    const float as = fl_abs(s), ac = fl_abs(c);
    const float t = fl_min(as, ac) / fl_max(fl_max(as, ac), 1e-20f);
    const float z = t * t, z2 = z * z;
    /* odd minimax of atan on [0, 1], fitted in float64: 1.7e-6 rad = 0.28 counts */
    const float a = t * ((0.999977219f - 0.332622823f * z) +
                         z2 * ((0.193540348f - 0.116426412f * z) + z2 * (0.0526472765f - 0.0117191066f * z)));
    const int32_t octant = (int32_t)(a * FL_CNT_PER_RAD + 0.5f);
    const int32_t quadrant = (as > ac) * (FL_TURN_CNT / 4) + fl_negate_if(as > ac, octant);
    const int32_t half = (c < 0.0f) * (FL_TURN_CNT / 2) + fl_negate_if(c < 0.0f, quadrant);
    return fl_negate_if(s < 0.0f, half) & (FL_TURN_CNT - 1);
}

#endif
