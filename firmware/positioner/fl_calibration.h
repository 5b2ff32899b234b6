/* What a finished self-calibration changes: parameters, references, flags. */
#ifndef FL_CALIBRATION_H
#define FL_CALIBRATION_H

#include "fl_positioner.h"

/* An axis has ended the plan of the calibration that p->state tells: its results become parameters. */
void fl_calibration_done(fl_positioner_t *p, int axis);

/* Whether the result of the calibration under way is a fit, which takes as long as a tick of both axes. */
static inline bool fl_calibration_fits(const fl_positioner_t *p) {
    return p->state == FL_STATE_HALL_CALIBRATION || p->state == FL_STATE_COGGING_CALIBRATION;
}

/* Index of the first parameter outside its limits, or of one that contradicts another; -1 if all is
 * well. The index counts the lines of FL_AXIS_PARAMS. */
int fl_params_fault(const fl_axis_params_t *params);

#endif
