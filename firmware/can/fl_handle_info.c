/* Commands that only read. */
#include "fl_commands.h"

#define UNUSED(x) (void)(x)

/* 04.01.21, least significant part first. */
enum { VERSION = 4 << 16 | 1 << 8 | 21 };

FL_HANDLER(fl_handle_id) {
    UNUSED(rq);
    fl_reply_u32(re, p->id);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_version) {
    UNUSED(p), UNUSED(rq);
    fl_reply_u32(re, VERSION);
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_status) {
    UNUSED(rq);
    fl_reply_u32(re, (uint32_t)p->status);
    fl_reply_u32(re, (uint32_t)(p->status >> 32));
    return FL_ACCEPTED;
}

FL_HANDLER(fl_handle_position) {
    UNUSED(rq);
    for (int i = 0; i < FL_AXES; ++i) fl_reply_u32(re, (uint32_t)p->axis[i].position_cnt);
    return FL_ACCEPTED;
}
