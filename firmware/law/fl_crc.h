/* CRC-32 of zip and Ethernet (polynomial 0x04C11DB7, reflected), half a byte at a time. */
#ifndef FL_CRC_H
#define FL_CRC_H

#include <stdint.h>

#define FL_CRC_START 0xffffffffu

/* The running CRC after `len` more bytes; begins with FL_CRC_START. Any length, 0 included. */
static inline uint32_t fl_crc_add(uint32_t crc, const void *bytes, uint32_t len) {
    static const uint32_t table[16] = {0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu,
                                       0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
                                       0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
                                       0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    const uint8_t *b = (const uint8_t *)bytes;
    for (uint32_t i = 0; i < len; ++i) {
        crc ^= b[i];
        crc = crc >> 4 ^ table[crc & 15u];
        crc = crc >> 4 ^ table[crc & 15u];
    }
    return crc;
}

/* The CRC-32 of all bytes added. */
static inline uint32_t fl_crc_end(uint32_t crc) { return ~crc; }

#endif
