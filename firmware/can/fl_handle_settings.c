/* Commands that change how the next move is made. */
#include "fl_commands.h"
#include "fl_dispatch.h"

#define UNUSED(x) (void)(x)

FL_HANDLER(fl_handle_set_position) {
    UNUSED(re);
    int32_t position[FL_AXES];
    for (int i = 0; i < FL_AXES; ++i) {
        position[i] = fl_get_i32(rq->data + 4 * i);
        if (!fl_axis_in_range(&p->axis[i], position[i])) return FL_VALUE_OUT_OF_RANGE;
    }
    fl_positioner_set_position(p, position);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_set_speed) {
    UNUSED(re);
    const uint32_t rpm[FL_AXES] = {fl_get_u32(rq->data), fl_get_u32(rq->data + 4)};
    for (int i = 0; i < FL_AXES; ++i)
        if (rpm[i] < 1 || rpm[i] > (uint32_t)p->params[i].speed_max) return FL_VALUE_OUT_OF_RANGE;
    for (int i = 0; i < FL_AXES; ++i) p->axis[i].speed_rpm = rpm[i];
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_loop) {
    UNUSED(re);
    for (int i = 0; i < FL_AXES; ++i) {
        if (!(rq->axes >> i & 1)) continue;
        p->axis[i].closed_loop = rq->arg & 1;
        p->axis[i].detect = rq->arg >> 1 & 1;
    }
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_precise) {
    UNUSED(re);
    for (int i = 0; i < FL_AXES; ++i)
        if (rq->axes >> i & 1) p->axis[i].precise = rq->arg;
    fl_positioner_refresh(p);
    return FL_ACCEPTED;
}
