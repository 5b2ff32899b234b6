/* Break-away torque (Kronig 2020, Section 2.4) from a slow sweep in each direction over whole turns.
 *
 * At creep speed the torque that keeps the rotor moving is the break-away torque of Eq. 9 plus
 * c_tot w, which is taken off. With signed torques, Eq. 11: T_spring = (mean+ + mean-)/2,
 * c_coulomb = mean+ - T_spring; the cogging is what has two cycles per turn (Fig. 11).
 */
#ifndef FL_FRICTION_FIT_H
#define FL_FRICTION_FIT_H

#include "fl_linear.h"

typedef struct fl_friction_fit {
    struct {
        float torque, torque_sin, torque_cos;
        uint32_t samples;
    } way[2]; /* positive, negative */
} fl_friction_fit_t;

typedef struct fl_friction {
    float coulomb_Nm, spring_Nm; /* spring: on the motor, positive in the positive direction */
    float cogging_Nm, cogging_phase_rad;
} fl_friction_t;

static inline void fl_friction_fit_reset(fl_friction_fit_t *f) {
    const fl_friction_fit_t empty = {{{0.0f, 0.0f, 0.0f, 0}, {0.0f, 0.0f, 0.0f, 0}}};
    *f = empty;
}

/* torque_Nm without the drag's share. */
static inline void fl_friction_fit_add(fl_friction_fit_t *f, bool negative, int32_t rotor_cnt,
                                       float torque_Nm) {
    const fl_sincos_t twice = fl_sincos_cnt(fl_add_i32(rotor_cnt, rotor_cnt));
    f->way[negative].torque += torque_Nm;
    f->way[negative].torque_sin += torque_Nm * twice.sin;
    f->way[negative].torque_cos += torque_Nm * twice.cos;
    ++f->way[negative].samples;
}

/* False when a direction was not swept or the friction is not positive. */
static inline bool fl_friction_fit_solve(const fl_friction_fit_t *f, fl_friction_t *out) {
    float mean[2], in_phase = 0.0f, quadrature = 0.0f;
    for (int i = 0; i < 2; ++i) {
        if (f->way[i].samples < 100) return false;
        const float per_sample = 1.0f / (float)f->way[i].samples;
        mean[i] = f->way[i].torque * per_sample;
        in_phase += f->way[i].torque_sin * per_sample; /* half the amplitude, twice */
        quadrature += f->way[i].torque_cos * per_sample;
    }
    const float resisting_spring = 0.5f * (mean[0] + mean[1]);
    out->coulomb_Nm = mean[0] - resisting_spring;
    out->spring_Nm = -resisting_spring;
    out->cogging_Nm = fl_sqrt(in_phase * in_phase + quadrature * quadrature);
    out->cogging_phase_rad = (float)fl_fold_cnt(fl_atan2_cnt(quadrature, in_phase)) * FL_RAD_PER_CNT;
    return out->coulomb_Nm > 0.0f;
}

#endif
