/* One reply for one request, always; the order of the checks is the order of the codes in doubt:
 * unknown, broadcast, length, state (the supervisor's table), value (the handler). */
#include "fl_dispatch.h"

#include "fl_commands.h"
#include "fl_identifier.h"
#include "fl_status.h"

static bool has(uint8_t mask, int axis) { return mask >> axis & 1; }

static uint64_t axis_status(const fl_positioner_t *p, int i) {
    const fl_axis_t *a = &p->axis[i];
    uint64_t s = 0;
    if (fl_axis_rests(a) && !has(p->chores, i)) s |= FL_STATUS_AXIS_COMPLETED(i);
    if (has(p->collided, i)) s |= FL_STATUS_AXIS_COLLISION(i);
    if (a->closed_loop) s |= FL_STATUS_AXIS_CLOSED_LOOP(i);
    if (a->precise) s |= FL_STATUS_AXIS_PRECISE(i);
    if (!a->detect) s |= FL_STATUS_AXIS_DETECT_DISABLED(i);
    if (has(p->hall_calibrated, i)) s |= FL_STATUS_AXIS_MOTOR_CALIBRATED(i);
    if (a->datum_calibrated) s |= FL_STATUS_AXIS_DATUM_CALIBRATED(i);
    if (has(p->datum_known, i)) s |= FL_STATUS_AXIS_DATUM_INITIALIZED(i);
    if (has(p->cogging_calibrated, i)) s |= FL_STATUS_AXIS_COGGING_CALIBRATED(i);
    return s;
}

static uint64_t mode_status(const fl_positioner_t *p) {
    switch (p->state) {
    case FL_STATE_LOADING:
        return FL_STATUS_RECEIVING_TRAJECTORY;
    case FL_STATE_HOMING:
        return FL_STATUS_DATUM_INITIALIZATION;
    case FL_STATE_HALL_CALIBRATION:
        return FL_STATUS_MOTOR_CALIBRATION;
    case FL_STATE_DATUM_CALIBRATION:
        return FL_STATUS_DATUM_CALIBRATION;
    case FL_STATE_COGGING_CALIBRATION:
        return FL_STATUS_COGGING_CALIBRATION;
    default:
        return 0;
    }
}

static uint64_t path_status(const fl_positioner_t *p) {
    if (p->state != FL_STATE_LOADING && p->state != FL_STATE_LOADED) return 0;
    uint64_t s = 0;
    if (p->path[FL_ALPHA].points == p->points[FL_ALPHA]) s |= FL_STATUS_TRAJECTORY_ALPHA_RECEIVED;
    if (p->path[FL_BETA].points == p->points[FL_BETA]) s |= FL_STATUS_TRAJECTORY_BETA_RECEIVED;
    return s;
}

/* After a move: off, or held with less than the full field. */
static uint64_t power_status(const fl_positioner_t *p) {
    const float hold = fl_max(p->params[FL_ALPHA].holding_voltage, p->params[FL_BETA].holding_voltage);
    return hold > 0.0f ? FL_STATUS_LOW_POWER_AFTER_MOVE : FL_STATUS_SWITCH_OFF_AFTER_MOVE;
}

void fl_positioner_refresh(fl_positioner_t *p) {
    uint64_t s = p->options | mode_status(p) | path_status(p) | power_status(p);
    if (p->params_good) s |= FL_STATUS_SYSTEM_INITIALIZED;
    if (p->settings_changed) s |= FL_STATUS_CONFIG_CHANGED;
    for (int i = 0; i < FL_AXES; ++i) s |= axis_status(p, i);
    const uint64_t both = FL_STATUS_AXIS_COMPLETED(0) | FL_STATUS_AXIS_COMPLETED(1);
    if ((s & both) == both && p->chores == 0) s |= FL_STATUS_DISPLACEMENT_COMPLETED;
    p->status = s;
}

uint32_t fl_positioner_conditions(const fl_positioner_t *p, uint8_t axes) {
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

void fl_positioner_flush(fl_positioner_t *p) {
    fl_tx_queue_t *q = &p->tx;
    while (q->count != 0 && p->port.send_frame(p->port.ctx, &q->frame[q->first])) {
        q->first = (uint8_t)((q->first + 1) % FL_TX_FRAMES);
        --q->count;
    }
}

/* The caller has made sure that there is room. */
static void queue(fl_positioner_t *p, fl_identifier_t id, const fl_reply_t *re) {
    fl_can_frame_t *f = &p->tx.frame[(p->tx.first + p->tx.count) % FL_TX_FRAMES];
    f->id = fl_identifier_pack(id);
    f->len = re->len;
    for (int i = 0; i < 8; ++i) f->data[i] = re->data[i];
    ++p->tx.count;
    fl_positioner_flush(p);
}

void fl_positioner_report_collision(fl_positioner_t *p) {
    const fl_identifier_t id = {p->id, 18, 0, 0};
    const fl_reply_t empty = {{0}, 0};
    if (p->tx.count < FL_TX_FRAMES) queue(p, id, &empty);
}

static fl_code_t execute(fl_positioner_t *p, const fl_command_row_t *row, const fl_can_frame_t *f,
                         fl_reply_t *re) {
    const fl_input_t input = (fl_input_t)row->input;
    const fl_verdict_t verdict =
        fl_supervisor_match((fl_state_t)p->state, input, fl_positioner_conditions(p, row->axes));
    if (verdict.code != FL_ACCEPTED) return (fl_code_t)verdict.code;
    const fl_request_t rq = {f->data, f->len, row->axes, row->arg};
    const fl_code_t code = row->handler(p, &rq, re);
    if (code == FL_ACCEPTED && input != FL_IN_QUERY) fl_positioner_enter(p, verdict.next);
    return code;
}

static fl_code_t answer(fl_positioner_t *p, fl_identifier_t id, const fl_can_frame_t *f, fl_reply_t *re) {
    const fl_command_row_t *row = fl_command_find(id.command);
    const bool boot = p->state == FL_STATE_BOOTLOADER;
    if (!row) return FL_UNKNOWN_COMMAND;
    if (boot && !(row->flags & FL_CMD_BOOTLOADER)) return FL_INVALID_BOOTLOADER_COMMAND;
    if (id.positioner == 0 && !(row->flags & FL_CMD_BROADCAST)) return FL_INVALID_BROADCAST_COMMAND;
    if (f->len < row->len_min || f->len > row->len_max) return FL_INCORRECT_AMOUNT_OF_DATA;
    return execute(p, row, f, re);
}

void fl_positioner_receive(fl_positioner_t *p, const fl_can_frame_t *frame) {
    const fl_identifier_t id = fl_identifier_unpack(frame->id);
    if (frame->id >> 29 != 0 || frame->len > 8) return;
    if (id.positioner != 0 && id.positioner != p->id) return;
    /* a code makes it a reply: answering those of a twin of ours would never end */
    if (id.code != 0) return;
    /* without room for the answer the request is not carried out either */
    if (p->tx.count != 0) fl_positioner_flush(p);
    if (p->tx.count == FL_TX_FRAMES) return;
    fl_reply_t re = {{0}, 0};
    const fl_code_t code = answer(p, id, frame, &re);
    if (code != FL_ACCEPTED) re.len = 0;
    const fl_identifier_t reply = {p->id, id.command, id.uid, (uint8_t)code};
    queue(p, reply, &re);
}
