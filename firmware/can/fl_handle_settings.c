/* Commands that change how the next move is made, and those that read such settings. */
#include "fl_commands.h"
#include "fl_status.h"
#include "fl_storage.h"

#define UNUSED(x) (void)(x)

static bool selected(const fl_request_t *rq, int axis) { return rq->axes >> axis & 1; }

static void reconfigure(fl_positioner_t *p) {
    for (int i = 0; i < FL_AXES; ++i) fl_axis_configure(&p->axis[i], &p->params[i]);
    p->settings_changed = true;
}

/* A little more than go-to allows: the datum itself may lie outside. */
FL_HANDLER(fl_handle_set_position) {
    UNUSED(re);
    const int32_t beyond = (int32_t)(10.0f * FL_CNT_PER_OUTPUT_DEG);
    int32_t position[FL_AXES];
    for (int i = 0; i < FL_AXES; ++i) {
        const fl_axis_law_t *law = &p->axis[i].law;
        position[i] = fl_get_i32(rq->data + 4 * i);
        if ((int64_t)position[i] < (int64_t)law->position_min_cnt - beyond ||
            (int64_t)position[i] > (int64_t)law->position_max_cnt + beyond)
            return FL_VALUE_OUT_OF_RANGE;
    }
    return fl_positioner_set_position(p, position) ? FL_ACCEPTED : FL_INVALID_COMMAND;
}

FL_HANDLER(fl_handle_get_offsets) {
    UNUSED(rq);
    for (int i = 0; i < FL_AXES; ++i) fl_reply_u32(re, (uint32_t)p->axis[i].offset_cnt);
    return FL_ACCEPTED;
}

/* Up to 10 degrees either way; the next datum search uses them. */
FL_HANDLER(fl_handle_set_offsets) {
    UNUSED(re);
    const int32_t most = (int32_t)(10.0f * FL_CNT_PER_OUTPUT_DEG);
    int32_t offset[FL_AXES];
    for (int i = 0; i < FL_AXES; ++i) {
        offset[i] = fl_get_i32(rq->data + 4 * i);
        if (offset[i] < -most || offset[i] > most) return FL_VALUE_OUT_OF_RANGE;
    }
    for (int i = 0; i < FL_AXES; ++i) p->axis[i].offset_cnt = offset[i];
    p->settings_changed = true;
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_set_speed) {
    UNUSED(re);
    const uint32_t rpm[FL_AXES] = {fl_get_u32(rq->data), fl_get_u32(rq->data + 4)};
    for (int i = 0; i < FL_AXES; ++i)
        if (rpm[i] < 1 || rpm[i] > (uint32_t)p->params[i].speed_max) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) p->axis[i].speed_rpm = rpm[i];
    return FL_ACCEPTED;
}

/* Percent of the full field: argument 0 in open loop, 1 at standstill. */
static float *current(fl_positioner_t *p, int axis, bool holding) {
    fl_axis_params_t *params = &p->params[axis];
    return holding ? &params->holding_voltage : &params->open_loop_voltage;
}

FL_HANDLER(fl_handle_set_current) {
    UNUSED(re);
    const uint32_t percent[FL_AXES] = {fl_get_u32(rq->data), fl_get_u32(rq->data + 4)};
    for (int i = 0; i < FL_AXES; ++i)
        if (percent[i] > 100) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) *current(p, i, rq->arg) = (float)percent[i] * 0.01f;
    reconfigure(p);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_get_current) {
    for (int i = 0; i < FL_AXES; ++i)
        fl_reply_u32(re, (uint32_t)fl_round_i32(*current(p, i, rq->arg) * 100.0f));
    return FL_ACCEPTED;
}

/* Motor degrees added to the tracking error that counts as a collision. */
FL_HANDLER(fl_handle_collision_margin) {
    UNUSED(re);
    const int32_t deg = fl_get_i32(rq->data);
    if (deg < -60 || deg > 360) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) p->axis[i].margin_rad = (float)deg * 0.017453293f;
    reconfigure(p);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_loop) {
    UNUSED(re);
    for (int i = 0; i < FL_AXES; ++i) {
        if (!selected(rq, i)) continue;
        p->axis[i].closed_loop = rq->arg & 1;
        p->axis[i].detect = rq->arg >> 1 & 1;
    }
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_precise) {
    UNUSED(re);
    for (int i = 0; i < FL_AXES; ++i)
        if (selected(rq, i)) p->axis[i].precise = rq->arg;
    fl_status_refresh(p);
    return FL_ACCEPTED;
}

/* Remembered only: this firmware never reads the sensors at rest. */
FL_HANDLER(fl_handle_hall_power) {
    UNUSED(re);
    if (rq->arg)
        p->options &= ~FL_STATUS(SWITCH_OFF_HALL_AFTER_MOVE);
    else
        p->options |= FL_STATUS(SWITCH_OFF_HALL_AFTER_MOVE);
    fl_status_refresh(p);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_led) {
    UNUSED(re);
    p->led = rq->arg;
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_set_trajectories) {
    UNUSED(re);
    p->trajectories = fl_get_u32(rq->data);
    p->settings_changed = true;
    fl_status_refresh(p);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_save) {
    UNUSED(rq), UNUSED(re);
    if (!fl_storage_save(p)) return FL_INVALID_COMMAND;
    p->options |= FL_STATUS(CALIBRATION_SAVED);
    p->settings_changed = false;
    return FL_ACCEPTED;
}
