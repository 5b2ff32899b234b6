/* The parameters over the bus. Numbers from 230 on, which no host of an instrument uses.
 *
 * A host names the table that it knows (231), sets values in a copy (232, 233) and asks for all of them to
 * take effect at once, with the CRC-32 of what the copy must hold (234). A frame lost on the way makes
 * another copy: it is refused, and the old parameters go on. Nothing is kept without a save (53). */
#include <stddef.h>

#include "fl_calibration.h"
#include "fl_commands.h"
#include "fl_crc.h"
#include "fl_dispatch.h"

#define UNUSED(x) (void)(x)

typedef struct line {
    const char *name, *unit;
    float range[3]; /* min, max, default */
} line_t;

static const line_t lines[] = {
#define X(name, unit, min, max, def, doc) {#name, unit, {(float)(min), (float)(max), (float)(def)}},
    FL_AXIS_PARAMS(X)
#undef X
};

enum { LINES = sizeof lines / sizeof *lines };
_Static_assert(sizeof(fl_axis_params_t) == LINES * sizeof(float), "every parameter is a float");
_Static_assert(LINES <= 255, "an index is a byte");

/* With its NUL. */
static uint32_t add_text(uint32_t crc, const char *text) {
    uint32_t len = 0;
    while (text[len]) ++len;
    return fl_crc_add(crc, text, len + 1);
}

uint32_t fl_params_table_crc(void) {
    uint32_t crc = FL_CRC_START;
    for (int i = 0; i < LINES; ++i) {
        crc = add_text(add_text(crc, lines[i].name), lines[i].unit);
        crc = fl_crc_add(crc, lines[i].range, sizeof lines[i].range);
    }
    return fl_crc_end(crc);
}

static uint32_t crc_of(const fl_axis_params_t params[FL_AXES]) {
    return fl_crc_end(fl_crc_add(FL_CRC_START, params, FL_AXES * (uint32_t)sizeof *params));
}

static float *value_of(fl_axis_params_t *params, uint8_t index) { return (float *)params + index; }

static int axis_of(const fl_request_t *rq) { return rq->axes == FL_ON_ALPHA ? FL_ALPHA : FL_BETA; }

/* CRC-32 of the table (names, units, ranges), and of the values in force: 2 KB to go through, so at rest
 * only, as a save. */
FL_HANDLER(fl_handle_params_table) {
    UNUSED(rq);
    fl_reply_u32(re, fl_params_table_crc());
    fl_reply_u32(re, crc_of(p->params));
    return FL_ACCEPTED;
}

/* The copy becomes what is in force now. */
FL_HANDLER(fl_handle_params_begin) {
    UNUSED(re);
    if (fl_get_u32(rq->data) != fl_params_table_crc()) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) p->staged[i] = p->params[i];
    p->staging = true;
    return FL_ACCEPTED;
}

/* u8 index, float32. */
FL_HANDLER(fl_handle_param_set) {
    UNUSED(re);
    const union {
        uint32_t bits;
        float value;
    } v = {fl_get_u32(rq->data + 1)};
    if (!p->staging) return FL_INVALID_COMMAND;
    if (rq->data[0] >= LINES) return FL_VALUE_OUT_OF_RANGE;
    const float *range = lines[rq->data[0]].range;
    if (!(v.value >= range[0] && v.value <= range[1])) return FL_VALUE_OUT_OF_RANGE;
    *value_of(&p->staged[axis_of(rq)], rq->data[0]) = v.value;
    return FL_ACCEPTED;
}

/* All or nothing. What was learnt of the old parameters is forgotten, as at power-up. */
FL_HANDLER(fl_handle_params_commit) {
    UNUSED(re);
    if (!p->staging || p->state != FL_STATE_IDLE) return FL_INVALID_COMMAND;
    if (crc_of(p->staged) != fl_get_u32(rq->data)) return FL_INVALID_COMMAND;
    for (int i = 0; i < FL_AXES; ++i)
        if (fl_params_fault(&p->staged[i]) >= 0) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) {
        fl_positioner_set_params(p, i, &p->staged[i]);
        fl_axis_unlearn(&p->axis[i], &p->params[i]);
    }
    p->staging = false;
    p->settings_changed = true;
    return FL_ACCEPTED;
}

/* u8 index; in return the index and the float32. */
FL_HANDLER(fl_handle_param_get) {
    if (rq->data[0] >= LINES) return FL_VALUE_OUT_OF_RANGE;
    union {
        float value;
        uint32_t bits;
    } v = {*value_of(&p->params[axis_of(rq)], rq->data[0])};
    re->data[re->len++] = rq->data[0];
    fl_reply_u32(re, v.bits);
    return FL_ACCEPTED;
}
