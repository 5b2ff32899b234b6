/* The hardware port: everything a board must provide to a positioner, and nothing else.
 *
 * A port is a struct of functions and a context. All functions are called from the 2 kHz control
 * interrupt (fl_positioner_tick), from fl_positioner_receive or from fl_positioner_init, never
 * concurrently; none may block. docs/firmware/porting.md walks through a board.
 */
#ifndef FL_PORT_H
#define FL_PORT_H

#include <stdbool.h>
#include <stdint.h>

#include "fl_tick.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { FL_ALPHA = 0, FL_BETA = 1, FL_AXES = 2 };

#define FL_HALL_ADC_MAX 4095 /* 12 bit, counts */

/* A classic CAN frame with a 29-bit identifier. */
typedef struct fl_can_frame {
    uint32_t id;
    uint8_t len; /* 0..8 */
    uint8_t data[8];
} fl_can_frame_t;

typedef struct fl_port {
    void *ctx;

    /* The two analogue hall channels of an axis in ADC counts, 0 to FL_HALL_ADC_MAX, sampled at the start
     * of the tick, both at once or within some microseconds. At most once per axis and tick, alpha first;
     * also outside the tick, when the position is declared or restored. Cannot fail: a dead sensor shows
     * as counts that lie too near the middle. */
    void (*read_hall)(void *ctx, int axis, uint16_t adc_cnt[2]);

    /* Average voltage of the phases A, B, C as fractions [0, 1] of u_dc, held until the next call and
     * changed together, at the latest half a tick later. {0, 0, 0} is off (all phases at ground: the coils
     * brake, they do not drive) and must work at once, whatever else goes on. */
    void (*set_phases)(void *ctx, int axis, const float duty[3]);

    /* Queues a frame for the bus, in the order of the calls. False when the mailbox is full: nothing was
     * taken, and the firmware tries again in the next tick. */
    bool (*send_frame)(void *ctx, const fl_can_frame_t *frame);

    /* Non-volatile storage, byte addressed: a byte may be written over without erasing others. Return the
     * number of bytes transferred. A write may be cut short by a power loss at any byte; the bytes before
     * are then kept, those after are as they were. At the start and the end of every motion some 130 bytes
     * are moved, by command 53 some 1400. Both NULL: nothing is kept. */
    uint32_t (*storage_read)(void *ctx, uint32_t offset, void *bytes, uint32_t len);
    uint32_t (*storage_write)(void *ctx, uint32_t offset, const void *bytes, uint32_t len);

    /* The last reading of the temperature sensor, in its own counts: command 132 passes it on, and the host
     * knows the scale. Called for that command alone. NULL: there is no sensor. */
    uint32_t (*read_temperature)(void *ctx);

    /* Opens the bridge of an axis, both switches of all three phases, until the next set_phases: no current
     * flows in the coils, so they neither drive nor brake. Called by the bench's torque step only (commands
     * 245, 246), in every tick that it lasts. The body diodes of the switches must not conduct: the voltage
     * that the rotor induces between two phases stays below the supply at any speed that the bridge itself
     * can reach. NULL: the board cannot, and such a step is refused. */
    void (*open_phases)(void *ctx, int axis);
} fl_port_t;

#ifdef __cplusplus
}
#endif
#endif
