#include "fl_positioner.h"

void fl_positioner_init(fl_positioner_t *p, const fl_port_t *port, uint16_t id,
                        const fl_axis_params_t params[FL_AXES]) {
    p->port = *port;
    p->id = id;
    for (int axis = 0; axis < FL_AXES; ++axis) p->params[axis] = params[axis];
    p->status = 0;
}
