/* Frames that wait for a mailbox of the bus; they leave in the order in which they were put in.
 *
 * Two frames have a place of their own, so that a full queue cannot lose them: that of a collision and the
 * answer to a stop. They follow what waits before them. */
#ifndef FL_OUTBOX_H
#define FL_OUTBOX_H

#include "fl_port.h"

enum { FL_OUTBOX_FRAMES = 16 };

typedef enum fl_urgent { FL_URGENT_COLLISION, FL_URGENT_STOP, FL_URGENT_KINDS } fl_urgent_t;

/* All zero: empty. */
typedef struct fl_outbox {
    uint8_t first, count;
    uint8_t waiting; /* bits of fl_urgent_t: still outside the queue, which is full */
    fl_can_frame_t frame[FL_OUTBOX_FRAMES];
    fl_can_frame_t urgent[FL_URGENT_KINDS];
} fl_outbox_t;

/* Whether no further frame may be put in. */
static inline bool fl_outbox_full(const fl_outbox_t *o) { return o->count == FL_OUTBOX_FRAMES; }

/* Puts a frame in and sends what the mailbox takes.
 * @pre !fl_outbox_full(o) */
void fl_outbox_put(fl_outbox_t *o, const fl_port_t *port, const fl_can_frame_t *frame);

/* The same for a frame that must not be lost: without room it waits in its own place, where it replaces an
 * older one of its kind. */
void fl_outbox_put_urgent(fl_outbox_t *o, const fl_port_t *port, fl_urgent_t kind,
                          const fl_can_frame_t *frame);

/* Sends what waits, as far as the mailbox takes it. */
void fl_outbox_flush(fl_outbox_t *o, const fl_port_t *port);

#endif
