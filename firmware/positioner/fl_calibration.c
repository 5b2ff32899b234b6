#include "fl_calibration.h"

#include <stddef.h>

#include "fl_status.h"

static uint8_t bit(int axis) { return (uint8_t)(1u << axis); }

/* The rotor is back where the calibration began; the position there stays what it was. */
static void keep_position(fl_axis_t *a, int32_t position_cnt) {
    const fl_sincos_t then = fl_hall_vector(&a->law.hall, a->start_adc_cnt);
    const fl_sincos_t now = fl_hall_vector(&a->law.hall, a->adc_cnt);
    const int32_t start = fl_atan2_cnt(then.sin, then.cos);
    const int32_t moved = fl_fold_cnt(fl_sub_i32(fl_atan2_cnt(now.sin, now.cos), start));
    a->hall.angle_cnt = fl_add_i32(start, moved);
    a->zero_cnt = fl_sub_i32(position_cnt, start);
    a->position_cnt = fl_add_i32(position_cnt, moved);
}

static void hall_done(fl_positioner_t *p, int axis) {
    fl_axis_t *a = &p->axis[axis];
    fl_axis_params_t *params = &p->params[axis];
    fl_hall_shape_t shape;
    if (!fl_hall_fit_solve(&a->fit.hall, &shape)) return;
    params->hall_offset_a = shape.offset_cnt[0];
    params->hall_offset_b = shape.offset_cnt[1];
    params->hall_amplitude_a = shape.amplitude_cnt[0];
    params->hall_amplitude_b = shape.amplitude_cnt[1];
    params->hall_phase = shape.phase_rad;
    a->hall_error_mdeg = fl_round_i32(shape.residual_rad * 57295.78f);
    fl_axis_configure(a, params);
    fl_axis_unlearn_touch(a, params);
    keep_position(a, a->start_cnt);
    p->hall_calibrated |= bit(axis);
    p->settings_changed = true;
}

static void cogging_done(fl_positioner_t *p, int axis) {
    fl_axis_t *a = &p->axis[axis];
    fl_axis_params_t *params = &p->params[axis];
    fl_friction_t f;
    if (!fl_friction_fit_solve(&a->fit.friction, &f)) return;
    const float here_rad = (float)a->position_cnt * FL_RAD_PER_CNT;
    params->coulomb = f.coulomb_Nm;
    params->spring_torque = f.spring_Nm - params->spring_rate * here_rad;
    params->cogging_torque = f.cogging_Nm;
    params->cogging_phase = f.cogging_phase_rad;
    fl_axis_configure(a, params);
    fl_axis_unlearn_touch(a, params);
    p->cogging_calibrated |= bit(axis);
    p->settings_changed = true;
}

void fl_calibration_done(fl_positioner_t *p, int axis) {
    const fl_axis_t *a = &p->axis[axis];
    switch (p->state) {
    case FL_STATE_HALL_CALIBRATION:
        hall_done(p, axis);
        break;
    case FL_STATE_COGGING_CALIBRATION:
        cogging_done(p, axis);
        break;
    case FL_STATE_DATUM_CALIBRATION:
    case FL_STATE_HOMING:
        if (a->datum_found) p->datum_known |= bit(axis);
        /* found at the stop: no longer a guess, nor what the storage said */
        if (p->datum_known == (bit(FL_ALPHA) | bit(FL_BETA)))
            p->options &= ~(FL_STATUS(ESTIMATED_POSITION) | FL_STATUS(POSITION_RESTORED));
        p->settings_changed |= a->datum_found && a->datum_calibrate;
        break;
    default:
        break;
    }
}

typedef struct limits {
    float min, max;
} limits_t;

static const limits_t limits[] = {
#define X(name, unit, min, max, def, doc) {(float)(min), (float)(max)},
    FL_AXIS_PARAMS(X)
#undef X
};

enum { PARAMS = sizeof limits / sizeof *limits };
_Static_assert(sizeof(fl_axis_params_t) == PARAMS * sizeof(float), "every parameter is a float");

#define INDEX(name) ((int)(offsetof(fl_axis_params_t, name) / sizeof(float)))

int fl_params_fault(const fl_axis_params_t *params) {
    const float *value = (const float *)params;
    for (int i = 0; i < PARAMS; ++i)
        if (!(value[i] >= limits[i].min && value[i] <= limits[i].max)) return i;
    if (!(params->position_min < params->position_max)) return INDEX(position_max);
    if (!(params->collision_torque > params->integral_limit)) return INDEX(collision_torque);
    if (!(params->speed_default <= params->speed_max)) return INDEX(speed_default);
    return -1;
}
