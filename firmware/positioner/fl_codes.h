/* Response codes, bits 3..0 of a reply's identifier. Numbers and names are the protocol's. */
#ifndef FL_CODES_H
#define FL_CODES_H

/* X(name, number) */
#define FL_CODES(X)                                                                                          \
    X(ACCEPTED, 0)                                                                                           \
    X(VALUE_OUT_OF_RANGE, 1)                                                                                 \
    X(INVALID_TRAJECTORY, 2)                                                                                 \
    X(ALREADY_IN_MOTION, 3)                                                                                  \
    X(DATUM_NOT_INITIALIZED, 4)                                                                              \
    X(INCORRECT_AMOUNT_OF_DATA, 5)                                                                           \
    X(CALIBRATION_MODE_ACTIVE, 6)                                                                            \
    X(MOTOR_NOT_CALIBRATED, 7)                                                                               \
    X(COLLISION_DETECTED, 8)                                                                                 \
    X(HALL_SENSOR_DISABLED, 9)                                                                               \
    X(INVALID_BROADCAST_COMMAND, 10)                                                                         \
    X(INVALID_BOOTLOADER_COMMAND, 11)                                                                        \
    X(INVALID_COMMAND, 12)                                                                                   \
    X(UNKNOWN_COMMAND, 13)                                                                                   \
    X(DATUM_NOT_CALIBRATED, 14)                                                                              \
    X(HALL_SENSORS_DISABLED, 15)

typedef enum fl_code {
#define X(name, number) FL_##name = (number),
    FL_CODES(X)
#undef X
} fl_code_t;

#endif
