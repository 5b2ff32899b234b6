/* The bootloader: takes a firmware image over the bus and checks its CRC-32. */
#ifndef FL_BOOT_H
#define FL_BOOT_H

#include "fl_positioner.h"

/* One tick in the bootloader: it gives up waiting after 10 s without an image under way. */
void fl_boot_tick(fl_positioner_t *p);

#endif
