/* What the bus asks of a positioner: frames, and the SYNC line. */
#ifndef FL_DISPATCH_H
#define FL_DISPATCH_H

#include "fl_positioner.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A frame seen on the bus, for this positioner or another. A request is answered through port->send_frame, at
 * once or in a later tick; without room for the answer it is not carried out, unless it stops (13, 15). Any
 * request is a sign of life of the host. Anything else is ignored.
 * @pre not during fl_positioner_tick: the same context */
void fl_positioner_receive(fl_positioner_t *p, const fl_can_frame_t *frame);

/* The SYNC line rises: like START_TRAJECTORY without an answer, and a sign of life, too.
 * @pre as above */
void fl_positioner_sync(fl_positioner_t *p);

#ifdef __cplusplus
}
#endif
#endif
