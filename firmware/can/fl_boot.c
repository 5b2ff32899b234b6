#include "fl_boot.h"

#include "fl_commands.h"
#include "fl_crc.h"
#include "fl_dispatch.h"
#include "fl_status.h"

enum { WAIT_TICKS = 10 * FL_TICK_HZ, IMAGE_MAX = 1 << 20 };

static void restart(fl_positioner_t *p, uint32_t status) {
    p->boot.status = status;
    p->boot.size = p->boot.received = p->boot.crc_expected = 0;
    p->boot.crc = FL_CRC_START;
    p->boot.until_tick = p->ticks + WAIT_TICKS;
}

void fl_positioner_enter_bootloader(fl_positioner_t *p) {
    /* whoever moves loses count: as after a power cut */
    if (p->state > FL_STATE_REFUSED) p->datum_known = 0;
    for (int axis = 0; axis < FL_AXES; ++axis) fl_axis_off(&p->axis[axis], &p->port, axis);
    p->state = FL_STATE_BOOTLOADER;
    restart(p, FL_BOOT_INIT);
}

void fl_boot_tick(fl_positioner_t *p) {
    if (p->boot.status & FL_BOOT_RECEIVING) return;
    if ((int32_t)(p->ticks - p->boot.until_tick) < 0) return;
    p->boot.status |= FL_BOOT_TIMEOUT;
    p->state = FL_STATE_IDLE;
    fl_positioner_refresh(p);
}

FL_HANDLER(fl_handle_upgrade) {
    (void)re;
    const uint32_t size = fl_get_u32(rq->data);
    if (size == 0 || size > IMAGE_MAX) return FL_VALUE_OUT_OF_RANGE;
    restart(p, FL_BOOT_INIT | FL_BOOT_RECEIVING);
    p->boot.size = size;
    p->boot.crc_expected = fl_get_u32(rq->data + 4);
    return FL_ACCEPTED;
}

/* The end of reception, good or bad; the wait for the main firmware begins anew. */
static fl_code_t close(fl_positioner_t *p, bool good) {
    p->boot.status &= ~FL_BOOT_RECEIVING;
    p->boot.status |= FL_BOOT_RECEIVED | (good ? FL_BOOT_CHECK_OK : FL_BOOT_CHECK_BAD);
    p->boot.until_tick = p->ticks + WAIT_TICKS;
    return good ? FL_ACCEPTED : FL_VALUE_OUT_OF_RANGE;
}

FL_HANDLER(fl_handle_image) {
    (void)re;
    fl_boot_t *b = &p->boot;
    if (!(b->status & FL_BOOT_RECEIVING)) return FL_INVALID_COMMAND;
    if (rq->len > b->size - b->received) return close(p, false);
    if (b->image_write && b->image_write(p->port.ctx, b->received, rq->data, rq->len) != rq->len)
        return close(p, false);
    b->crc = fl_crc_add(b->crc, rq->data, rq->len);
    b->received += rq->len;
    if (b->received < b->size) return FL_ACCEPTED;
    return close(p, fl_crc_end(b->crc) == b->crc_expected);
}
