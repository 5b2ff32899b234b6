/* Between the bus and the positioner: what the handlers and the control interrupt share. */
#ifndef FL_DISPATCH_H
#define FL_DISPATCH_H

#include "fl_positioner.h"

/* Recomputes the status word from the state. */
void fl_positioner_refresh(fl_positioner_t *p);

/* FL_IF_... bits that hold for any of the axes in the mask. */
uint32_t fl_positioner_conditions(const fl_positioner_t *p, uint8_t axes);

/* A command was carried out: the supervisor's next state, with all that follows. */
void fl_positioner_enter(fl_positioner_t *p, uint8_t state);

/* An event from inside moves the supervisor on. */
void fl_positioner_apply(fl_positioner_t *p, fl_input_t input);

/* Both axes: phases off. */
void fl_positioner_brake(fl_positioner_t *p);

/* Queues the unsolicited frame 18. */
void fl_positioner_report_collision(fl_positioner_t *p);

/* Sends what waits, as far as the mailbox takes it. */
void fl_positioner_flush(fl_positioner_t *p);

#endif
