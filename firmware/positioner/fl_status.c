#include "fl_status.h"

static bool has(uint8_t mask, int axis) { return mask >> axis & 1; }

/* The bits of an axis: that of alpha, shifted by the axis. */
#define PAIR(alpha, beta)                                                                                    \
    _Static_assert(FL_BIT_##beta == FL_BIT_##alpha + 1, "the bit of beta follows that of alpha")
PAIR(TRAJECTORY_ALPHA_RECEIVED, TRAJECTORY_BETA_RECEIVED);
PAIR(DISPLACEMENT_COMPLETED_ALPHA, DISPLACEMENT_COMPLETED_BETA);
PAIR(COLLISION_ALPHA, COLLISION_BETA);
PAIR(CLOSED_LOOP_ALPHA, CLOSED_LOOP_BETA);
PAIR(PRECISE_POSITIONING_ALPHA, PRECISE_POSITIONING_BETA);
PAIR(COLLISION_DETECT_ALPHA_DISABLE, COLLISION_DETECT_BETA_DISABLE);
PAIR(MOTOR_ALPHA_CALIBRATED, MOTOR_BETA_CALIBRATED);
PAIR(DATUM_ALPHA_CALIBRATED, DATUM_BETA_CALIBRATED);
PAIR(DATUM_ALPHA_INITIALIZED, DATUM_BETA_INITIALIZED);
PAIR(COGGING_ALPHA_CALIBRATED, COGGING_BETA_CALIBRATED);

static uint64_t axis_status(const fl_positioner_t *p, int i) {
    const fl_axis_t *a = &p->axis[i];
    uint64_t s = 0;
    if (fl_axis_rests(a) && !has(p->chores, i)) s |= FL_STATUS(DISPLACEMENT_COMPLETED_ALPHA);
    if (has(p->collided, i)) s |= FL_STATUS(COLLISION_ALPHA);
    if (a->closed_loop) s |= FL_STATUS(CLOSED_LOOP_ALPHA);
    if (a->precise) s |= FL_STATUS(PRECISE_POSITIONING_ALPHA);
    if (!a->detect) s |= FL_STATUS(COLLISION_DETECT_ALPHA_DISABLE);
    if (has(p->hall_calibrated, i)) s |= FL_STATUS(MOTOR_ALPHA_CALIBRATED);
    if (a->datum_calibrated) s |= FL_STATUS(DATUM_ALPHA_CALIBRATED);
    if (has(p->datum_known, i)) s |= FL_STATUS(DATUM_ALPHA_INITIALIZED);
    if (has(p->cogging_calibrated, i)) s |= FL_STATUS(COGGING_ALPHA_CALIBRATED);
    return s << i;
}

static uint64_t mode_status(const fl_positioner_t *p) {
    switch (p->state) {
    case FL_STATE_LOADING:
        return FL_STATUS(RECEIVING_TRAJECTORY);
    case FL_STATE_HOMING:
        return FL_STATUS(DATUM_INITIALIZATION);
    case FL_STATE_HALL_CALIBRATION:
        return FL_STATUS(MOTOR_CALIBRATION);
    case FL_STATE_DATUM_CALIBRATION:
        return FL_STATUS(DATUM_CALIBRATION);
    case FL_STATE_COGGING_CALIBRATION:
        return FL_STATUS(COGGING_CALIBRATION);
    default:
        return 0;
    }
}

static uint64_t path_status(const fl_positioner_t *p) {
    if (p->state != FL_STATE_LOADING && p->state != FL_STATE_LOADED) return 0;
    uint64_t s = 0;
    for (int i = 0; i < FL_AXES; ++i)
        if (p->path[i].points == p->points[i]) s |= FL_STATUS(TRAJECTORY_ALPHA_RECEIVED) << i;
    return s;
}

/* After a move: off, or held with less than the full field. */
static uint64_t power_status(const fl_positioner_t *p) {
    const float hold = fl_max(p->params[FL_ALPHA].holding_voltage, p->params[FL_BETA].holding_voltage);
    return hold > 0.0f ? FL_STATUS(LOW_POWER_AFTER_MOVE) : FL_STATUS(SWITCH_OFF_AFTER_MOVE);
}

void fl_status_refresh(fl_positioner_t *p) {
    uint64_t s = p->options | mode_status(p) | path_status(p) | power_status(p);
    if (p->params_good) s |= FL_STATUS(SYSTEM_INITIALIZED);
    if (p->settings_changed) s |= FL_STATUS(CONFIG_CHANGED);
    for (int i = 0; i < FL_AXES; ++i) s |= axis_status(p, i);
    const uint64_t both = FL_STATUS(DISPLACEMENT_COMPLETED_ALPHA) | FL_STATUS(DISPLACEMENT_COMPLETED_BETA);
    if ((s & both) == both && p->chores == 0) s |= FL_STATUS(DISPLACEMENT_COMPLETED);
    p->status = s;
}

uint32_t fl_status_conditions(const fl_positioner_t *p, uint8_t axes) {
    uint32_t c = p->collided ? FL_IF_COLLIDED : 0;
    if (!p->params_good) c |= FL_IF_BAD_PARAMETERS;
    for (int i = 0; i < FL_AXES; ++i) {
        if (!has(axes, i)) continue;
        if (!has(p->hall_calibrated, i)) c |= FL_IF_HALL_UNCALIBRATED;
        if (!p->axis[i].datum_calibrated) c |= FL_IF_DATUM_UNCALIBRATED;
        if (!has(p->datum_known, i)) c |= FL_IF_DATUM_UNKNOWN;
    }
    return c;
}
