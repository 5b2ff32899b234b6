/* CRC-32 of zip and Ethernet (polynomial 0x04C11DB7, reflected), bit by bit: small, rarely used. */
#ifndef FL_CRC_H
#define FL_CRC_H

#include <stdint.h>

#define FL_CRC_START 0xffffffffu

static inline uint32_t fl_crc_add(uint32_t crc, const void *bytes, uint32_t len) {
    const uint8_t *b = (const uint8_t *)bytes;
    for (uint32_t i = 0; i < len; ++i) {
        crc ^= b[i];
        for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (0xedb88320u & (0u - (crc & 1u)));
    }
    return crc;
}

static inline uint32_t fl_crc_end(uint32_t crc) { return ~crc; }

#endif
