/* Collision detection: Kronig 2020, Eq. 22: |feedback term| > T_threshold. By Eq. 23 (which divides
 * by K_P, not K_I as printed) that is a tracking error between (T_threshold -+ T_I_max)/K_P.
 *
 * At speed the threshold grows with what the drag may be wrong by (grease in the cold): at 2000 rpm
 * by 13 uNm for alpha, so that a blocked rotor is found in 15 ms instead of 11, inside the 16 ms that
 * the paper allows.
 *
 * A blocked rotor is one thing, a blocked arm another: it winds up the gear first. Where K_P is high
 * enough for the feedback to follow the load within some ms, `contact_Nm` finds that much earlier: it
 * watches the resisting side only, for crossing the backlash unloads the motor by more.
 *
 * In open loop there is no feedback term. A magnet that follows lags the field by less than 90
 * degrees; a blocked one lets the field turn away. The same smallest error as in closed loop is the
 * limit there.
 */
#ifndef FL_COLLISION_H
#define FL_COLLISION_H

#include "fl_math.h"

/* Setting out from inside the backlash costs more than driving on; and slow contacts are gentle. */
#define FL_CONTACT_SLOW 0.8f    /* added share at standstill */
#define FL_CONTACT_RAD_S 100.0f /* none from here on */

typedef struct fl_collision_config {
    float threshold_Nm;
    float contact_Nm;
    float drag;            /* Nm s/rad */
    float drag_share;      /* of the drag torque, added to threshold_Nm */
    int32_t error_min_cnt; /* Eq. 23, lower bound */
} fl_collision_config_t;

typedef struct fl_collision_in {
    float feedback_Nm;
    float speed_rad_s, direction; /* commanded */
    float drag_doubt;             /* share of the drag that may not have been learnt yet */
} fl_collision_in_t;

/* Closed loop, Eq. 22: true when the rotor or the arm is blocked, from the feedback term and the commanded
 * speed of this tick.
 * @pre in.direction is -1, 0 or 1; in.drag_doubt >= 0 */
static inline bool fl_collision_closed(const fl_collision_config_t *cfg, fl_collision_in_t in) {
    const float drag_Nm = cfg->drag * fl_abs(in.speed_rad_s);
    const bool stuck = fl_abs(in.feedback_Nm) > cfg->threshold_Nm + cfg->drag_share * drag_Nm;
    const float slow = fl_max(1.0f - fl_abs(in.speed_rad_s) * (1.0f / FL_CONTACT_RAD_S), 0.0f);
    const float contact_Nm = cfg->contact_Nm * (1.0f + FL_CONTACT_SLOW * slow) + in.drag_doubt * drag_Nm;
    const bool contact = in.feedback_Nm * in.direction > contact_Nm;
    return stuck || contact;
}

/* Open loop: true when the rotor is further from the field than error_min_cnt, either way. */
static inline bool fl_collision_open(const fl_collision_config_t *cfg, int32_t field_minus_rotor_cnt) {
    return field_minus_rotor_cnt > cfg->error_min_cnt || field_minus_rotor_cnt < -cfg->error_min_cnt;
}

#endif
