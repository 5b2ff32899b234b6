/* The 29-bit identifier: positioner 28..18, command 17..10, uid 9..4, response code 3..0. */
#ifndef FL_IDENTIFIER_H
#define FL_IDENTIFIER_H

#include <stdint.h>

/* The unsolicited frame that tells of a collision; its uid is 0. */
enum { FL_ID_COLLISION = 18 };

enum { FL_ID_POSITIONER_MAX = 2047, FL_ID_COMMAND_MAX = 255, FL_ID_UID_MAX = 63, FL_ID_CODE_MAX = 15 };

typedef struct fl_identifier {
    uint16_t positioner; /* 0 = broadcast */
    uint8_t command, uid, code;
} fl_identifier_t;

/* The identifier as the bus has it; fields beyond their range are cut to it. */
static inline uint32_t fl_identifier_pack(fl_identifier_t f) {
    return (uint32_t)(f.positioner & FL_ID_POSITIONER_MAX) << 18 | (uint32_t)f.command << 10 |
           (uint32_t)(f.uid & FL_ID_UID_MAX) << 4 | (uint32_t)(f.code & FL_ID_CODE_MAX);
}

/* Its fields; bits 31..29 are ignored. */
static inline fl_identifier_t fl_identifier_unpack(uint32_t id) {
    const fl_identifier_t f = {(uint16_t)(id >> 18 & FL_ID_POSITIONER_MAX), (uint8_t)(id >> 10),
                               (uint8_t)(id >> 4 & FL_ID_UID_MAX), (uint8_t)(id & FL_ID_CODE_MAX)};
    return f;
}

#endif
