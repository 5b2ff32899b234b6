/* What a positioner tells of itself: the 64-bit status word of firmware >= 04.01.00, and the conditions
 * that the supervisor asks for. */
#ifndef FL_STATUS_H
#define FL_STATUS_H

#include "fl_positioner.h"

/* X(name, bit). Names are the protocol's; a pair of axes has two bits, that of alpha first. Bits 2, 3, 37
 * and 38 belong to the protocol, and this firmware never sets them, nor 28 and 29. 40 is a mark of hosts; 41
 * and 42 are this firmware's own: the host watch ended the last trajectory; the storage did not take the last
 * position. */
#define FL_STATUS_BITS(X)                                                                                    \
    X(SYSTEM_INITIALIZED, 0)                                                                                 \
    X(CONFIG_CHANGED, 1)                                                                                     \
    X(BSETTINGS_CHANGED, 2)                                                                                  \
    X(DATA_STREAMING, 3)                                                                                     \
    X(RECEIVING_TRAJECTORY, 4)                                                                               \
    X(TRAJECTORY_ALPHA_RECEIVED, 5)                                                                          \
    X(TRAJECTORY_BETA_RECEIVED, 6)                                                                           \
    X(LOW_POWER_AFTER_MOVE, 7)                                                                               \
    X(DISPLACEMENT_COMPLETED, 8)                                                                             \
    X(DISPLACEMENT_COMPLETED_ALPHA, 9)                                                                       \
    X(DISPLACEMENT_COMPLETED_BETA, 10)                                                                       \
    X(COLLISION_ALPHA, 11)                                                                                   \
    X(COLLISION_BETA, 12)                                                                                    \
    X(CLOSED_LOOP_ALPHA, 13)                                                                                 \
    X(CLOSED_LOOP_BETA, 14)                                                                                  \
    X(PRECISE_POSITIONING_ALPHA, 15)                                                                         \
    X(PRECISE_POSITIONING_BETA, 16)                                                                          \
    X(COLLISION_DETECT_ALPHA_DISABLE, 17)                                                                    \
    X(COLLISION_DETECT_BETA_DISABLE, 18)                                                                     \
    X(MOTOR_CALIBRATION, 19)                                                                                 \
    X(MOTOR_ALPHA_CALIBRATED, 20)                                                                            \
    X(MOTOR_BETA_CALIBRATED, 21)                                                                             \
    X(DATUM_CALIBRATION, 22)                                                                                 \
    X(DATUM_ALPHA_CALIBRATED, 23)                                                                            \
    X(DATUM_BETA_CALIBRATED, 24)                                                                             \
    X(DATUM_INITIALIZATION, 25)                                                                              \
    X(DATUM_ALPHA_INITIALIZED, 26)                                                                           \
    X(DATUM_BETA_INITIALIZED, 27)                                                                            \
    X(HALL_ALPHA_DISABLE, 28)                                                                                \
    X(HALL_BETA_DISABLE, 29)                                                                                 \
    X(COGGING_CALIBRATION, 30)                                                                               \
    X(COGGING_ALPHA_CALIBRATED, 31)                                                                          \
    X(COGGING_BETA_CALIBRATED, 32)                                                                           \
    X(ESTIMATED_POSITION, 33)                                                                                \
    X(POSITION_RESTORED, 34)                                                                                 \
    X(SWITCH_OFF_AFTER_MOVE, 35)                                                                             \
    X(CALIBRATION_SAVED, 36)                                                                                 \
    X(PRECISE_MOVE_IN_OPEN_LOOP_ALPHA, 37)                                                                   \
    X(PRECISE_MOVE_IN_OPEN_LOOP_BETA, 38)                                                                    \
    X(SWITCH_OFF_HALL_AFTER_MOVE, 39)                                                                        \
    X(HOST_TIMEOUT, 41)                                                                                      \
    X(STORAGE_FAILED, 42)

enum {
#define X(name, bit) FL_BIT_##name = (bit),
    FL_STATUS_BITS(X)
#undef X
};

/* A bit of the word by its name. */
#define FL_STATUS(name) ((uint64_t)1 << FL_BIT_##name)

/* Recomputes p->status from the state. */
void fl_status_refresh(fl_positioner_t *p);

/* FL_IF_... bits that hold for any of the axes in the mask (bit 0 alpha, bit 1 beta). */
uint32_t fl_status_conditions(const fl_positioner_t *p, uint8_t axes);

#endif
