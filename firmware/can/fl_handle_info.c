/* Commands that only read. */
#include "fl_commands.h"

#define UNUSED(x) (void)(x)

/* 04.01.21, least significant part first; the bootloader says 04.80.21. */
enum { VERSION = 4 << 16 | 1 << 8 | 21, BOOT_VERSION = 4 << 16 | 80 << 8 | 21 };

FL_HANDLER(fl_handle_id) {
    UNUSED(rq);
    fl_reply_u32(re, p->id);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_version) {
    UNUSED(rq);
    fl_reply_u32(re, p->state == FL_STATE_BOOTLOADER ? BOOT_VERSION : VERSION);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_status) {
    UNUSED(rq);
    if (p->state == FL_STATE_BOOTLOADER) {
        fl_reply_u32(re, p->boot.status);
        return FL_ACCEPTED;
    }
    fl_reply_u32(re, (uint32_t)p->status);
    fl_reply_u32(re, (uint32_t)(p->status >> 32));
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_position) {
    UNUSED(rq);
    for (int i = 0; i < FL_AXES; ++i) fl_reply_u32(re, (uint32_t)p->axis[i].position_cnt);
    return FL_ACCEPTED;
}

/* rms residual of the last hall calibration, motor millidegrees. */
FL_HANDLER(fl_handle_hall_error) {
    UNUSED(rq);
    for (int i = 0; i < FL_AXES; ++i) fl_reply_u32(re, (uint32_t)p->axis[i].hall_error_mdeg);
    return FL_ACCEPTED;
}

static void reply_u16(fl_reply_t *re, float cnt) {
    const int32_t v = fl_round_i32(fl_clamp(cnt, 0.0f, (float)FL_HALL_ADC_MAX));
    re->data[re->len++] = (uint8_t)v;
    re->data[re->len++] = (uint8_t)(v >> 8);
}

/* Largest and smallest counts of both channels: max A, max B, min A, min B. */
FL_HANDLER(fl_handle_hall_range) {
    const fl_axis_params_t *q = &p->params[rq->axes == FL_ON_ALPHA ? FL_ALPHA : FL_BETA];
    reply_u16(re, q->hall_offset_a + q->hall_amplitude_a);
    reply_u16(re, q->hall_offset_b + q->hall_amplitude_b);
    reply_u16(re, q->hall_offset_a - q->hall_amplitude_a);
    reply_u16(re, q->hall_offset_b - q->hall_amplitude_b);
    return FL_ACCEPTED;
}

/* Counts of a board without a sensor: a constant, as real units send it. */
enum { NO_SENSOR_CNT = 1900 };

FL_HANDLER(fl_handle_temperature) {
    UNUSED(rq);
    const fl_port_t *port = &p->port;
    fl_reply_u32(re, port->read_temperature ? port->read_temperature(port->ctx) : NO_SENSOR_CNT);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_trajectories) {
    UNUSED(rq);
    fl_reply_u32(re, p->trajectories);
    return FL_ACCEPTED;
}
