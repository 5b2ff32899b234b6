/* Frames that wait for a mailbox of the bus; they leave in the order in which they were put in. */
#ifndef FL_OUTBOX_H
#define FL_OUTBOX_H

#include "fl_port.h"

enum { FL_OUTBOX_FRAMES = 16 };

/* All zero: empty. */
typedef struct fl_outbox {
    uint8_t first, count;
    fl_can_frame_t frame[FL_OUTBOX_FRAMES];
} fl_outbox_t;

/* Whether no further frame may be put in. */
static inline bool fl_outbox_full(const fl_outbox_t *o) { return o->count == FL_OUTBOX_FRAMES; }

/* Puts a frame in and sends what the mailbox takes.
 * @pre !fl_outbox_full(o) */
void fl_outbox_put(fl_outbox_t *o, const fl_port_t *port, const fl_can_frame_t *frame);

/* Sends what waits, as far as the mailbox takes it. */
void fl_outbox_flush(fl_outbox_t *o, const fl_port_t *port);

#endif
