/* Trajectories, go-to moves, the datum search, stop. */
#include "fl_commands.h"
#include "fl_dispatch.h"
#include "fl_status.h"

#include <stddef.h>

#define UNUSED(x) (void)(x)

/* Six days; keeps the arithmetic of a segment inside 32 bits. */
#define LAST_TICK (1 << 29)

FL_HANDLER(fl_handle_new_trajectory) {
    UNUSED(re);
    const uint32_t n[FL_AXES] = {fl_get_u32(rq->data), fl_get_u32(rq->data + 4)};
    for (int i = 0; i < FL_AXES; ++i)
        if (n[i] < 1 || n[i] > FL_PATH_POINTS) return FL_VALUE_OUT_OF_RANGE;
    fl_positioner_drop_paths(p);
    fl_trace_start(&p->trace, 0); /* its memory is needed */
    for (int i = 0; i < FL_AXES; ++i) p->points[i] = (uint16_t)n[i];
    return FL_ACCEPTED;
}

/* The axis whose point comes next: first all of alpha's, then beta's; FL_AXES when all are in. */
static int next_axis(const fl_positioner_t *p) {
    int axis = 0;
    while (axis < FL_AXES && p->path[axis].points == p->points[axis]) ++axis;
    return axis;
}

static bool too_fast(const fl_axis_t *a, int32_t way_cnt, int64_t ticks) {
    const int64_t most = (int64_t)a->law.speed_max_cnt_tick * ticks;
    return way_cnt > most || way_cnt < -most;
}

FL_HANDLER(fl_handle_point) {
    UNUSED(re);
    const int axis = next_axis(p);
    if (axis == FL_AXES) return FL_INVALID_TRAJECTORY;
    const fl_axis_t *a = &p->axis[axis];
    const int32_t position = fl_get_i32(rq->data), tick = fl_get_i32(rq->data + 4);
    if (!fl_axis_in_range(a, position) || tick < 0 || tick > LAST_TICK) return FL_VALUE_OUT_OF_RANGE;
    fl_path_t *path = &p->path[axis];
    /* order and speed are judged at the end (12): the frames of one bite may all be under way */
    if (path->points > 0 &&
        too_fast(a, fl_sub_i32(position, path->last_cnt), (int64_t)tick - path->last_tick))
        p->path_bad = true;
    if (tick <= path->last_tick) {
        p->path_bad = true;
        ++path->points;
    } else if (!fl_path_append(path, position, tick)) {
        return FL_VALUE_OUT_OF_RANGE;
    }
    return FL_ACCEPTED;
}

/* From here to the first point, the smoothing counted in. */
static bool start_too_far(const fl_axis_t *a, const fl_path_t *path) {
    int32_t first;
    uint32_t ticks;
    fl_path_read(path, 0, &first, &ticks);
    return too_fast(a, fl_sub_i32(first, a->position_cnt), (int64_t)ticks + FL_SMOOTH_TICKS);
}

static bool trajectory_good(const fl_positioner_t *p) {
    if (p->path_bad || next_axis(p) != FL_AXES) return false;
    return !start_too_far(&p->axis[FL_ALPHA], &p->path[FL_ALPHA]) &&
           !start_too_far(&p->axis[FL_BETA], &p->path[FL_BETA]);
}

FL_HANDLER(fl_handle_end) {
    UNUSED(rq), UNUSED(re);
    if (trajectory_good(p)) return FL_ACCEPTED;
    fl_positioner_apply(p, FL_IN_BAD_TRAJECTORY);
    fl_status_refresh(p);
    return FL_INVALID_TRAJECTORY;
}

void fl_positioner_sync(fl_positioner_t *p) {
    const fl_verdict_t verdict =
        fl_supervisor_match((fl_state_t)p->state, FL_IN_START, fl_status_conditions(p, FL_ON_BOTH));
    p->heard_tick = p->ticks;
    if (verdict.code != FL_ACCEPTED || fl_handle_start(p, NULL, NULL) != FL_ACCEPTED) return;
    fl_positioner_enter(p, verdict.next);
}

FL_HANDLER(fl_handle_start) {
    UNUSED(rq), UNUSED(re);
    if (p->state != FL_STATE_LOADED) return FL_ACCEPTED;
    if (!trajectory_good(p)) return FL_INVALID_TRAJECTORY;
    for (int i = 0; i < FL_AXES; ++i) fl_axis_follow(&p->axis[i], &p->path[i]);
    ++p->trajectories;
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_stop) {
    UNUSED(re);
    fl_positioner_drop_paths(p);
    fl_positioner_brake(p);
    if (rq->arg) {
        p->collided = 0;
        p->options &= ~FL_STATUS(HOST_TIMEOUT);
    }
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_goto) {
    int32_t target[FL_AXES];
    for (int i = 0; i < FL_AXES; ++i) {
        const fl_axis_t *a = &p->axis[i];
        const int64_t from = rq->arg ? a->position_cnt : 0;
        const int64_t to = from + fl_get_i32(rq->data + 4 * i);
        if (to < INT32_MIN || to > INT32_MAX || !fl_axis_in_range(a, (int32_t)to))
            return FL_VALUE_OUT_OF_RANGE;
        target[i] = (int32_t)to;
    }
    fl_positioner_drop_paths(p);
    for (int i = 0; i < FL_AXES; ++i) {
        fl_reply_u32(re, fl_axis_goto_ticks(&p->axis[i], target[i]));
        fl_axis_goto(&p->axis[i], target[i]);
    }
    return FL_ACCEPTED;
}

/* Which of the plans that need no target. */
static void begin(fl_axis_t *a, uint8_t input) {
    switch (input) {
    case FL_IN_CALIBRATE_HALL:
        fl_axis_calibrate_hall(a);
        break;
    case FL_IN_CALIBRATE_COGGING:
        fl_axis_calibrate_cogging(a);
        break;
    default:
        fl_axis_home(a, input == FL_IN_CALIBRATE_DATUM);
        break;
    }
}

FL_HANDLER(fl_handle_calibrate) {
    UNUSED(re);
    fl_positioner_drop_paths(p);
    for (int i = 0; i < FL_AXES; ++i) {
        if (!(rq->axes >> i & 1)) continue;
        if (rq->input == FL_IN_HOME || rq->input == FL_IN_CALIBRATE_DATUM)
            p->datum_known &= (uint8_t)~(1u << i);
        begin(&p->axis[i], rq->input);
    }
    return FL_ACCEPTED;
}
