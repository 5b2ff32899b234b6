#include "fl_outbox.h"

void fl_outbox_flush(fl_outbox_t *o, const fl_port_t *port) {
    while (o->count != 0 && port->send_frame(port->ctx, &o->frame[o->first])) {
        o->first = (uint8_t)((o->first + 1) % FL_OUTBOX_FRAMES);
        --o->count;
    }
}

void fl_outbox_put(fl_outbox_t *o, const fl_port_t *port, const fl_can_frame_t *frame) {
    o->frame[(o->first + o->count) % FL_OUTBOX_FRAMES] = *frame;
    ++o->count;
    fl_outbox_flush(o, port);
}
