/* Break-away torque (Kronig 2020, Section 2.4) from a slow sweep in each direction.
 *
 * At creep speed the torque that keeps the rotor moving is the break-away torque of Eq. 9 plus
 * c_tot w, which is taken off. Least squares of
 *   T = c_coulomb sgn(w) - S + A sin(2 theta) + B cos(2 theta)
 * over both directions is Eq. 11 (with signed torques, S = -T_spring the spring's torque on the
 * motor) and Fig. 11's two cogging cycles per turn at once, and does not mind that the rotor spends
 * more time where cogging slows it.
 */
#ifndef FL_FRICTION_FIT_H
#define FL_FRICTION_FIT_H

#include "fl_linear.h"

enum { FL_FRICTION_TERMS = 4 };

typedef struct fl_friction_fit {
    uint32_t samples[2]; /* positive, negative */
    fl_normal_t normal;
} fl_friction_fit_t;

typedef struct fl_friction {
    float coulomb_Nm, spring_Nm; /* spring: on the motor, positive in the positive direction */
    float cogging_Nm, cogging_phase_rad;
} fl_friction_t;

/* Forgets all samples. */
static inline void fl_friction_fit_reset(fl_friction_fit_t *f) {
    const fl_friction_fit_t empty = {{0, 0}, {{{0}}}};
    *f = empty;
}

/* torque_Nm without the drag's share. */
static inline void fl_friction_fit_add(fl_friction_fit_t *f, bool negative, int32_t rotor_cnt,
                                       float torque_Nm) {
    const fl_sincos_t twice = fl_sincos_cnt(fl_add_i32(rotor_cnt, rotor_cnt));
    const float basis[FL_FRICTION_TERMS] = {negative ? -1.0f : 1.0f, 1.0f, twice.sin, twice.cos};
    fl_normal_add(&f->normal, FL_FRICTION_TERMS, basis, torque_Nm);
    ++f->samples[negative];
}

/* False when a direction was not swept or the friction is not positive. */
static inline bool fl_friction_fit_solve(fl_friction_fit_t *f, fl_friction_t *out) {
    float x[FL_FRICTION_TERMS], explained;
    if (f->samples[0] < 100 || f->samples[1] < 100) return false;
    if (!fl_normal_solve(&f->normal, FL_FRICTION_TERMS, x, &explained)) return false;
    out->coulomb_Nm = x[0];
    out->spring_Nm = -x[1];
    out->cogging_Nm = fl_sqrt(x[2] * x[2] + x[3] * x[3]);
    out->cogging_phase_rad = (float)fl_fold_cnt(fl_atan2_cnt(x[3], x[2])) * FL_RAD_PER_CNT;
    return out->coulomb_Nm > 0.0f;
}

#endif
