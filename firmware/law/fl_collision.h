/* Collision detection: Kronig 2020, Eq. 22: |feedback term| > T_threshold. By Eq. 23 (which divides
 * by K_P, not K_I as printed) that is a tracking error between (T_threshold -+ T_I_max)/K_P.
 *
 * At speed the threshold grows with what the drag may be wrong by (grease in the cold): at 2000 rpm
 * by 13 uNm for alpha, so that a blocked rotor is found in 15 ms instead of 11, inside the 16 ms that
 * the paper allows.
 *
 * In open loop there is no feedback term. A magnet that follows lags the field by less than 90
 * degrees; a blocked one lets the field turn away. The same smallest error as in closed loop is the
 * limit there.
 */
#ifndef FL_COLLISION_H
#define FL_COLLISION_H

#include "fl_math.h"

typedef struct fl_collision_config {
    float threshold_Nm;
    float drag_doubt;      /* Nm s/rad: what the drag may be wrong by before it is learnt */
    int32_t error_min_cnt; /* Eq. 23, lower bound */
} fl_collision_config_t;

static inline bool fl_collision_closed(const fl_collision_config_t *cfg, float feedback_Nm,
                                       float speed_rad_s) {
    return fl_abs(feedback_Nm) > cfg->threshold_Nm + cfg->drag_doubt * fl_abs(speed_rad_s);
}

static inline bool fl_collision_open(const fl_collision_config_t *cfg, int32_t field_minus_rotor_cnt) {
    return field_minus_rotor_cnt > cfg->error_min_cnt || field_minus_rotor_cnt < -cfg->error_min_cnt;
}

#endif
