#include "fl_positioner.h"

#include "fl_calibration.h"
#include "fl_identifier.h"
#include "fl_status.h"
#include "fl_storage.h"

static bool params_good(const fl_positioner_t *p) {
    return fl_params_fault(&p->params[FL_ALPHA]) < 0 && fl_params_fault(&p->params[FL_BETA]) < 0;
}

/* The shorter of those of both axes that are not 0. One tick more: a trajectory has then begun. */
static uint32_t host_watch_ticks(const fl_positioner_t *p) {
    uint32_t least = 0;
    for (int axis = 0; axis < FL_AXES; ++axis) {
        const float ms = p->params[axis].host_timeout_ms;
        const uint32_t ticks = ms > 0.0f ? 1u + (uint32_t)(ms * (FL_TICK_HZ * 1e-3f) + 0.5f) : 0;
        if (ticks != 0 && (least == 0 || ticks < least)) least = ticks;
    }
    return least;
}

/* The parameters have changed. */
static void judge_params(fl_positioner_t *p) {
    p->params_good = params_good(p);
    p->host_watch_ticks = p->params_good ? host_watch_ticks(p) : 0;
    fl_status_refresh(p);
}

void fl_positioner_init(fl_positioner_t *p, const fl_port_t *port, uint16_t id,
                        const fl_axis_params_t params[FL_AXES]) {
    p->port = *port;
    p->id = id;
    for (int axis = 0; axis < FL_AXES; ++axis) {
        p->params[axis] = p->staged[axis] = params[axis];
        fl_axis_init(&p->axis[axis], &p->params[axis]);
        p->points[axis] = 0;
        fl_path_clear(&p->path[axis]);
    }
    p->state = FL_STATE_IDLE;
    p->collided = p->datum_known = p->cogging_calibrated = 0;
    p->hall_calibrated = FL_BOTH_AXES; /* the factory parameters describe this unit */
    p->path_bad = p->settings_changed = p->led = p->staging = false;
    p->chores = 0;
    p->options = 0;
    p->ticks = p->heard_tick = p->trajectories = 0;
    p->tx.first = p->tx.count = p->tx.waiting = 0;
    p->boot = (fl_boot_t){0, 0, 0, 0, 0, 0, 0};
    fl_trace_start(&p->trace, 0);
    fl_storage_load(p);
    judge_params(p);
}

bool fl_positioner_set_params(fl_positioner_t *p, int axis, const fl_axis_params_t *params) {
    if (!fl_axis_rests(&p->axis[axis])) return false;
    p->params[axis] = *params;
    fl_axis_configure(&p->axis[axis], params);
    judge_params(p);
    return true;
}

bool fl_positioner_settled(const fl_positioner_t *p, int axis) {
    return (p->datum_known >> axis & 1) || (p->options & FL_STATUS(POSITION_RESTORED));
}

bool fl_positioner_set_position(fl_positioner_t *p, const int32_t position_cnt[FL_AXES]) {
    const bool noted = fl_storage_declare_position(p, position_cnt);
    for (int axis = 0; noted && axis < FL_AXES; ++axis)
        fl_axis_set_position(&p->axis[axis], &p->port, axis, position_cnt[axis],
                             fl_positioner_settled(p, axis));
    if (noted) {
        p->datum_known = FL_BOTH_AXES;
        p->options &= ~(FL_STATUS(ESTIMATED_POSITION) | FL_STATUS(POSITION_RESTORED));
    }
    fl_status_refresh(p);
    return noted;
}

void fl_positioner_drop_paths(fl_positioner_t *p) {
    for (int i = 0; i < FL_AXES; ++i) {
        fl_path_clear(&p->path[i]);
        p->points[i] = 0;
    }
    p->path_bad = false;
}

static bool axes_rest(const fl_positioner_t *p) {
    return fl_axis_rests(&p->axis[FL_ALPHA]) && fl_axis_rests(&p->axis[FL_BETA]);
}

bool fl_positioner_at_rest(const fl_positioner_t *p) {
    return axes_rest(p) && p->chores == 0 && p->state != FL_STATE_BOOTLOADER && p->tx.count == 0 &&
           p->axis[FL_ALPHA].voltage == 0.0f && p->axis[FL_BETA].voltage == 0.0f;
}

void fl_positioner_skip(fl_positioner_t *p, uint32_t ticks) { p->ticks += ticks; }

/* The plan is made and no tick has passed: nothing has moved yet. */
static void stay(fl_positioner_t *p) {
    fl_positioner_drop_paths(p);
    for (int axis = 0; axis < FL_AXES; ++axis) fl_axis_off(&p->axis[axis], &p->port, axis);
    p->state = FL_STATE_IDLE;
}

bool fl_positioner_enter(fl_positioner_t *p, uint8_t state) {
    const bool sets_out = p->state <= FL_STATE_REFUSED && state > FL_STATE_REFUSED;
    const bool may = !sets_out || fl_storage_note_position(p, true);
    if (sets_out) p->options &= ~FL_STATUS(HOST_TIMEOUT);
    p->state = state;
    if (!may) stay(p);
    fl_status_refresh(p);
    return may;
}

void fl_positioner_apply(fl_positioner_t *p, fl_input_t input) {
    p->state = fl_supervisor_match((fl_state_t)p->state, input, fl_status_conditions(p, FL_BOTH_AXES)).next;
}

void fl_positioner_brake(fl_positioner_t *p) {
    for (int axis = 0; axis < FL_AXES; ++axis) fl_axis_brake(&p->axis[axis], &p->port, axis);
}

void fl_positioner_enter_bootloader(fl_positioner_t *p) {
    /* an axis in motion loses count: as after a power cut */
    if (p->state > FL_STATE_REFUSED) p->datum_known = 0;
    for (int axis = 0; axis < FL_AXES; ++axis) fl_axis_off(&p->axis[axis], &p->port, axis);
    p->state = FL_STATE_BOOTLOADER;
    fl_boot_start(&p->boot, p->ticks);
}

/* The one frame that is no answer: COLLISION_DETECTED. */
static void report_collision(fl_positioner_t *p) {
    const fl_identifier_t id = {p->id, FL_ID_COLLISION, 0, 0};
    const fl_can_frame_t frame = {fl_identifier_pack(id), 0, {0}};
    fl_outbox_put_urgent(&p->tx, &p->port, FL_URGENT_COLLISION, &frame);
}

/* Eq. 22 has fired: both axes stop, the host is told. */
static void collide(fl_positioner_t *p, int axis) {
    const bool first = p->collided == 0;
    p->collided |= (uint8_t)(1u << axis);
    fl_positioner_brake(p);
    fl_positioner_apply(p, FL_IN_COLLISION);
    fl_status_refresh(p);
    if (first) report_collision(p);
}

enum { RESULTS = FL_CHORE_RESULT_ALPHA | FL_CHORE_RESULT_BETA };
_Static_assert(FL_CHORE_RESULT_ALPHA == 1 << FL_ALPHA && FL_CHORE_RESULT_BETA == 1 << FL_BETA, "by axis");

static void axis_done(fl_positioner_t *p, int axis) {
    p->chores &= (uint8_t)~(1u << axis);
    fl_calibration_done(p, axis);
    if (axes_rest(p) && !(p->chores & RESULTS)) {
        fl_positioner_apply(p, FL_IN_DONE);
        p->chores |= FL_CHORE_NOTE;
    }
    fl_status_refresh(p);
}

/* The fits of both axes and the storage in one tick would be long. */
static void do_chore(fl_positioner_t *p) {
    if (p->chores & FL_CHORE_RESULT_ALPHA) {
        axis_done(p, FL_ALPHA);
    } else if (p->chores & FL_CHORE_RESULT_BETA) {
        axis_done(p, FL_BETA);
    } else {
        fl_storage_note_position(p, false);
        /* the displacement is completed when its end is known to outlive a power cut */
        fl_status_refresh(p);
    }
}

/* The tick before this one: an axis that sets out now was at rest in it. */
static void trace(fl_positioner_t *p) {
    for (int i = 0; i < FL_AXES; ++i) {
        const fl_axis_t *a = &p->axis[i];
        if (fl_axis_rests(a) || a->fresh) continue;
        fl_trace_add(&p->trace, i, &p->path[i], a->position_cnt, a->voltage);
    }
}

/* A trajectory goes on only while the host is heard. */
static void watch_host(fl_positioner_t *p) {
    const bool follows = p->state == FL_STATE_MOVING && p->points[FL_ALPHA] != 0;
    if (!follows || p->ticks - p->heard_tick < p->host_watch_ticks) return;
    if (p->options & FL_STATUS(HOST_TIMEOUT)) return;
    p->options |= FL_STATUS(HOST_TIMEOUT);
    for (int axis = 0; axis < FL_AXES; ++axis) fl_axis_slow_down(&p->axis[axis]);
    fl_status_refresh(p);
}

bool fl_positioner_begin_tick(fl_positioner_t *p) {
    ++p->ticks;
    if (p->trace.decimation != 0) trace(p);
    if (p->tx.count != 0) fl_outbox_flush(&p->tx, &p->port);
    if (p->chores != 0) do_chore(p);
    if (p->host_watch_ticks != 0) watch_host(p);
    if (p->state != FL_STATE_BOOTLOADER) return true;
    if (fl_boot_tick(&p->boot, p->ticks)) {
        p->state = FL_STATE_IDLE;
        fl_status_refresh(p);
    }
    return false;
}

void fl_positioner_end_axis(fl_positioner_t *p, int axis, fl_axis_event_t event) {
    switch (event) {
    case FL_AXIS_DONE:
        if (fl_calibration_fits(p))
            p->chores |= (uint8_t)(1u << axis);
        else
            axis_done(p, axis);
        break;
    case FL_AXIS_BLOCKED:
        collide(p, axis);
        break;
    case FL_AXIS_NONE:
        break;
    }
}

void fl_positioner_tick(fl_positioner_t *p) {
    if (!fl_positioner_begin_tick(p)) return;
    for (int i = 0; i < FL_AXES; ++i)
        if (!fl_axis_rests(&p->axis[i]))
            fl_positioner_end_axis(p, i, fl_axis_tick(&p->axis[i], &p->path[i], &p->port, i));
}

fl_axis_telemetry_t fl_positioner_telemetry(const fl_positioner_t *p, int axis) {
    const fl_axis_t *a = &p->axis[axis];
    const float per_cnt = 1.0f / FL_CNT_PER_MOTOR_DEG;
    const int32_t folded = (int32_t)((uint32_t)a->command.position_cnt << 8) >> 8;
    const fl_axis_telemetry_t t = {
        .command_deg = (float)folded * per_cnt,
        .tracking_deg = (float)fl_sub_i32(a->command.position_cnt, a->position_cnt) * per_cnt,
        .speed_rad_s = a->command.speed_rad_s,
        .feedback_Nm = a->torque.watched_Nm,
        .feedforward_Nm = a->torque.feedforward_Nm,
        .voltage = a->voltage,
        .load_Nm = a->drive.touch.rise_Nm,
        .touch_Nm = a->drive.touch.limit_Nm,
    };
    return t;
}

int32_t fl_positioner_position(const fl_positioner_t *p, int axis) { return p->axis[axis].position_cnt; }
