/* Engineering commands for a bench: the trace, and torque steps. Numbers from 240 on, which no host of an
 * instrument uses. */
#include "fl_commands.h"

#define UNUSED(x) (void)(x)

static int axis_of(const fl_request_t *rq) { return rq->axes == FL_ON_ALPHA ? FL_ALPHA : FL_BETA; }

static uint16_t get_u16(const uint8_t *b) { return (uint16_t)(b[0] | b[1] << 8); }

static void reply_u16(fl_reply_t *re, uint16_t v) {
    re->data[re->len++] = (uint8_t)v;
    re->data[re->len++] = (uint8_t)(v >> 8);
}

/* Ticks per sample, 0 for off. The trace takes the memory of the trajectories, so none may be loaded. */
FL_HANDLER(fl_handle_trace_start) {
    UNUSED(re);
    if (p->state != FL_STATE_IDLE) return FL_INVALID_COMMAND;
    fl_trace_start(&p->trace, get_u16(rq->data));
    return FL_ACCEPTED;
}

/* Samples recorded, ticks per sample, and the position that belongs to rotor angle zero. */
FL_HANDLER(fl_handle_trace_state) {
    const int axis = axis_of(rq);
    reply_u16(re, p->trace.axis[axis].count);
    reply_u16(re, p->trace.decimation);
    fl_reply_u32(re, (uint32_t)p->axis[axis].zero_cnt);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_trace_read) {
    const int axis = axis_of(rq);
    const uint16_t index = get_u16(rq->data);
    if (index >= p->trace.axis[axis].count) return FL_VALUE_OUT_OF_RANGE;
    const fl_trace_sample_t sample = fl_trace_get(&p->path[axis], index);
    fl_reply_u32(re, (uint32_t)sample.position_cnt);
    reply_u16(re, (uint16_t)sample.voltage);
    return FL_ACCEPTED;
}

/* Whether a part of the step wants the bridge open. */
static bool opens(const fl_torque_step_t *step) {
    return step->voltage[0] == FL_TORQUE_OPEN || step->voltage[1] == FL_TORQUE_OPEN;
}

/* Two voltages (i16, 32767 = u_dc; -32768: the bridge is open) and for how many ticks each. */
FL_HANDLER(fl_handle_torque_step) {
    UNUSED(re);
    const fl_torque_step_t step = {{(int16_t)get_u16(rq->data), (int16_t)get_u16(rq->data + 2)},
                                   {get_u16(rq->data + 4), get_u16(rq->data + 6)}};
    if ((uint32_t)step.ticks[0] + step.ticks[1] > FL_TORQUE_TICKS) return FL_VALUE_OUT_OF_RANGE;
    if (opens(&step) && !p->port.open_phases) return FL_UNKNOWN_COMMAND;
    for (int i = 0; i < FL_AXES; ++i) p->points[i] = 0; /* a loaded trajectory is dropped, as by a go-to */
    fl_axis_push(&p->axis[axis_of(rq)], step);
    return FL_ACCEPTED;
}
