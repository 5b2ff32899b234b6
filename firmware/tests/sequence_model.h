/* What a host may conclude from the traffic alone: whether anything may move.
 *
 * Written from the protocol, not from the firmware: it knows neither states nor legs. It sees requests that
 * were accepted or not, the SYNC line, power, and the bit that says all displacement has been completed.
 */
#ifndef SEQUENCE_MODEL_H
#define SEQUENCE_MODEL_H

#include <stdbool.h>
#include <stdint.h>

typedef struct sequence_model {
    bool loading, loaded;
    uint64_t wanted, got; /* points announced by 10, accepted by 11 */
    bool driven;          /* something accepted may drive the motors */
    bool braking;         /* it was stopped, and has not come to rest */
    bool holds;           /* a holding current was asked for, perhaps saved: it flows after a move */
} sequence_model_t;

static inline void sequence_drop(sequence_model_t *m) { m->loading = m->loaded = false; }

static inline void sequence_power_up(sequence_model_t *m) {
    sequence_drop(m);
    m->driven = m->braking = false;
}

/* The status says that all displacement is completed. */
static inline void sequence_rests(sequence_model_t *m) { m->driven = m->braking = false; }

static inline bool sequence_may_drive(const sequence_model_t *m) {
    return m->driven || (m->braking && m->holds);
}

/* The bootloader, and whatever else switches the motors off. */
static inline void sequence_off(sequence_model_t *m) {
    sequence_drop(m);
    m->braking = m->driven || m->braking;
    m->driven = false;
}

static inline void sequence_start(sequence_model_t *m) {
    if (m->loaded) m->driven = true;
    sequence_drop(m);
}

static inline void sequence_load(sequence_model_t *m, uint64_t points) {
    m->loading = true;
    m->loaded = false;
    m->wanted = points;
    m->got = 0;
}

static inline bool sequence_moves(uint8_t command) {
    return (command >= 20 && command <= 28) || command == 30 || command == 31 ||
           (command >= 47 && command <= 49) || command == 245 || command == 246;
}

/* A holding voltage as a parameter (234) does what 112 does. */
static inline void sequence_hold(sequence_model_t *m, float voltage) {
    m->holds = m->holds || voltage > 0.0f;
}

/* A request was carried out. points: what command 10 announced, both axes. False: it never should have been.
 */
static inline bool sequence_accepted(sequence_model_t *m, uint8_t command, uint64_t points, bool current) {
    if (sequence_moves(command)) {
        sequence_drop(m);
        m->driven = true;
    }
    switch (command) {
    case 10:
        sequence_load(m, points);
        return true;
    case 11:
        return m->loading && ++m->got <= m->wanted;
    case 12:
        m->loaded = m->loading && m->got == m->wanted;
        m->loading = false;
        return m->loaded;
    case 13:
    case 15:
        sequence_off(m);
        return true;
    case 14:
        sequence_start(m);
        return true;
    case 112:
        m->holds = m->holds || current;
        return true;
    default:
        return true;
    }
}

/* A bad trajectory (code 2) is refused until the next 10; any other code changes nothing. */
static inline void sequence_refused(sequence_model_t *m, uint8_t command, uint8_t code) {
    if (command == 12 && code == 2) m->loading = false;
}

#endif
