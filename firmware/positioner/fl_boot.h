/* The bootloader: takes a firmware image in pieces, checks its CRC-32, and gives up waiting after 10 s. */
#ifndef FL_BOOT_H
#define FL_BOOT_H

#include <stdbool.h>
#include <stdint.h>

/* Bits of its status word. */
#define FL_BOOT_INIT 0x1u
#define FL_BOOT_TIMEOUT 0x2u
#define FL_BOOT_RECEIVING 0x10000u
#define FL_BOOT_RECEIVED 0x1000000u
#define FL_BOOT_CHECK_OK 0x2000000u
#define FL_BOOT_CHECK_BAD 0x4000000u

/* Bytes of the largest image. */
enum { FL_BOOT_IMAGE_MAX = 1 << 20 };

/* What the bootloader knows of the image that arrives. */
typedef struct fl_boot {
    uint32_t status; /* FL_BOOT_... */
    uint32_t size, crc_expected;
    uint32_t received, crc;
    uint32_t until_tick; /* then the main firmware starts */
    /* Where a board puts the image; returns the bytes taken. NULL: received, checked, dropped. */
    uint32_t (*image_write)(void *ctx, uint32_t offset, const void *bytes, uint32_t len);
} fl_boot_t;

/* Waits for an image from now on; `tick` is the present one. */
void fl_boot_start(fl_boot_t *b, uint32_t tick);

/* An image of `size` bytes with this CRC-32 is announced. False, and nothing changed, where the size is not
 * within 1..FL_BOOT_IMAGE_MAX. */
bool fl_boot_announce(fl_boot_t *b, uint32_t size, uint32_t crc, uint32_t tick);

/* The next `len` bytes of the image. False where the image has failed: longer than announced, not taken by
 * image_write (called with `ctx`), or another CRC. The wait then begins anew, as after a good image.
 * @pre b->status & FL_BOOT_RECEIVING */
bool fl_boot_take(fl_boot_t *b, void *ctx, const uint8_t *bytes, uint8_t len, uint32_t tick);

/* One tick in the bootloader. True when it has waited for 10 s without an image under way: the main
 * firmware is to start. */
bool fl_boot_tick(fl_boot_t *b, uint32_t tick);

#endif
