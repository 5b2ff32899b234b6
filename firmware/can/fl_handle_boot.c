/* Commands of the bootloader: an image is announced and arrives in pieces. */
#include "fl_commands.h"

FL_HANDLER(fl_handle_upgrade) {
    (void)re;
    const uint32_t size = fl_get_u32(rq->data), crc = fl_get_u32(rq->data + 4);
    return fl_boot_announce(&p->boot, size, crc, p->ticks) ? FL_ACCEPTED : FL_VALUE_OUT_OF_RANGE;
}

FL_HANDLER(fl_handle_image) {
    (void)re;
    if (!(p->boot.status & FL_BOOT_RECEIVING)) return FL_INVALID_COMMAND;
    const bool good = fl_boot_take(&p->boot, p->port.ctx, rq->data, rq->len, p->ticks);
    return good ? FL_ACCEPTED : FL_VALUE_OUT_OF_RANGE;
}
