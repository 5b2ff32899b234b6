#include "fl_boot.h"

#include "fl_crc.h"
#include "fl_tick.h"

enum { WAIT_TICKS = 10 * FL_TICK_HZ };

static void restart(fl_boot_t *b, uint32_t status, uint32_t tick) {
    b->status = status;
    b->size = b->received = b->crc_expected = 0;
    b->crc = FL_CRC_START;
    b->until_tick = tick + WAIT_TICKS;
}

void fl_boot_start(fl_boot_t *b, uint32_t tick) { restart(b, FL_BOOT_INIT, tick); }

bool fl_boot_tick(fl_boot_t *b, uint32_t tick) {
    if (b->status & FL_BOOT_RECEIVING) return false;
    if ((int32_t)(tick - b->until_tick) < 0) return false;
    b->status |= FL_BOOT_TIMEOUT;
    return true;
}

bool fl_boot_announce(fl_boot_t *b, uint32_t size, uint32_t crc, uint32_t tick) {
    if (size == 0 || size > FL_BOOT_IMAGE_MAX) return false;
    restart(b, FL_BOOT_INIT | FL_BOOT_RECEIVING, tick);
    b->size = size;
    b->crc_expected = crc;
    return true;
}

/* The end of reception, good or bad; the wait for the main firmware begins anew. */
static bool close(fl_boot_t *b, bool good, uint32_t tick) {
    b->status &= ~FL_BOOT_RECEIVING;
    b->status |= FL_BOOT_RECEIVED | (good ? FL_BOOT_CHECK_OK : FL_BOOT_CHECK_BAD);
    b->until_tick = tick + WAIT_TICKS;
    return good;
}

bool fl_boot_take(fl_boot_t *b, void *ctx, const uint8_t *bytes, uint8_t len, uint32_t tick) {
    if (len > b->size - b->received) return close(b, false, tick);
    if (b->image_write && b->image_write(ctx, b->received, bytes, len) != len) return close(b, false, tick);
    b->crc = fl_crc_add(b->crc, bytes, len);
    b->received += len;
    if (b->received < b->size) return true;
    return close(b, fl_crc_end(b->crc) == b->crc_expected, tick);
}
