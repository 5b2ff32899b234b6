#include "fl_outbox.h"

static void drain(fl_outbox_t *o, const fl_port_t *port) {
    while (o->count != 0 && port->send_frame(port->ctx, &o->frame[o->first])) {
        o->first = (uint8_t)((o->first + 1) % FL_OUTBOX_FRAMES);
        --o->count;
    }
}

static void append(fl_outbox_t *o, const fl_can_frame_t *frame) {
    o->frame[(o->first + o->count) % FL_OUTBOX_FRAMES] = *frame;
    ++o->count;
}

/* Into the queue, as far as there is room. */
static void admit_urgent(fl_outbox_t *o) {
    for (int kind = 0; kind < FL_URGENT_KINDS; ++kind) {
        if (!(o->waiting >> kind & 1) || fl_outbox_full(o)) continue;
        append(o, &o->urgent[kind]);
        o->waiting &= (uint8_t)~(1u << kind);
    }
}

void fl_outbox_flush(fl_outbox_t *o, const fl_port_t *port) {
    drain(o, port);
    if (o->waiting == 0) return;
    admit_urgent(o);
    drain(o, port);
}

void fl_outbox_put(fl_outbox_t *o, const fl_port_t *port, const fl_can_frame_t *frame) {
    append(o, frame);
    fl_outbox_flush(o, port);
}

void fl_outbox_put_urgent(fl_outbox_t *o, const fl_port_t *port, fl_urgent_t kind,
                          const fl_can_frame_t *frame) {
    o->urgent[kind] = *frame;
    o->waiting |= (uint8_t)(1u << kind);
    fl_outbox_flush(o, port);
}
