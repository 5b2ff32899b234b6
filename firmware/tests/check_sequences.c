/* Sensible commands on hardware that loses power, at any byte of a write too: is a positioner where it says?
 *
 *   check_sequences [STEPS [SEED]]      default one million steps, seed 1
 *
 * A step is a move, a trajectory started by a frame or by the SYNC line, a stop, a datum search, a rotor that
 * something holds, a queue that is full, storage that takes only so many bytes, a power cut, a bootloader, or
 * some ticks. The rotors of the port are the truth: they turn with the voltage, on over many turns, and end
 * at a hard stop. Checked after every step: one that says that it knows both datums is where it says.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fl_axis_parts.h"
#include "fl_dispatch.h"
#include "fl_identifier.h"
#include "fl_status.h"
#include "fl_storage.h"

enum { OWN_ID = 77, HOME_CNT = 3 * FL_TURN_CNT, NEAR_CNT = FL_TURN_CNT, STOPPED_TICKS = 40000 };

typedef struct rig {
    uint64_t random;
    float duty[FL_AXES][3];
    int32_t rotor_cnt[FL_AXES], zero_cnt[FL_AXES]; /* position = rotor + zero */
    int32_t stop_cnt[FL_AXES];                     /* of the rotor: the datum */
    bool held, mailbox_full;
    bool dead; /* power has failed in the middle of a call */
    bool fails_at_cut;
    uint8_t storage[FL_STORAGE_BYTES];
    uint32_t write_budget;
    fl_code_t last_code;
    uint8_t uid;
    uint64_t cuts, cuts_in_motion, cuts_in_write, known_after_cut, refused, homed, arrived;
} rig_t;

static uint32_t random_u32(rig_t *r) {
    r->random ^= r->random << 13;
    r->random ^= r->random >> 7;
    r->random ^= r->random << 17;
    return (uint32_t)(r->random >> 32);
}

static bool chance(rig_t *r, uint32_t one_in) { return random_u32(r) % one_in == 0; }

#define REQUIRE(condition, ...)                                                                              \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "check_sequences: " __VA_ARGS__);                                                \
            fprintf(stderr, " (%s)\n", #condition);                                                          \
            exit(1);                                                                                         \
        }                                                                                                    \
    } while (0)

/* -- the port ---------------------------------------------------------------------------------------- */

static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    const rig_t *r = ctx;
    const fl_sincos_t v = fl_sincos_cnt(r->rotor_cnt[axis]);
    adc_cnt[0] = (uint16_t)(2048.0f + 1500.0f * v.sin);
    adc_cnt[1] = (uint16_t)(2048.0f + 1500.0f * v.cos);
}

/* The speed of a rotor without inertia is that of its torque: 9 deg a tick at the full voltage. */
static void set_phases(void *ctx, int axis, const float duty[3]) {
    rig_t *r = ctx;
    const float u_cos = duty[2] - 0.5f * (duty[0] + duty[1]), u_sin = 0.8660254f * (duty[1] - duty[0]);
    const fl_sincos_t v = fl_sincos_cnt(r->rotor_cnt[axis]);
    if (r->held || r->dead) return;
    const float step = (float)FL_TURN_CNT * (9.0f / 360.0f) * (u_sin * v.cos - u_cos * v.sin);
    const int32_t next = fl_add_i32(r->rotor_cnt[axis], (int32_t)step);
    r->rotor_cnt[axis] = next < r->stop_cnt[axis] ? r->stop_cnt[axis] : next;
}

static bool send_frame(void *ctx, const fl_can_frame_t *f) {
    rig_t *r = ctx;
    if (r->mailbox_full) return false;
    const fl_identifier_t id = fl_identifier_unpack(f->id);
    if (id.command != FL_ID_COLLISION) r->last_code = (fl_code_t)id.code;
    return true;
}

static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    const rig_t *r = ctx;
    if (r->dead || offset + len > sizeof r->storage) return 0;
    memcpy(bytes, r->storage + offset, len);
    return len;
}

static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    rig_t *r = ctx;
    if (r->dead || offset + len > sizeof r->storage) return 0;
    const uint32_t n = len < r->write_budget ? len : r->write_budget;
    memcpy(r->storage + offset, bytes, n);
    r->write_budget -= n;
    if (n < len && r->fails_at_cut) r->dead = true;
    return n;
}

/* -- the host ---------------------------------------------------------------------------------------- */

static fl_code_t ask(rig_t *r, fl_positioner_t *p, uint8_t command, int32_t first, int32_t second,
                     uint8_t len) {
    r->uid = (uint8_t)(1 + r->uid % 63);
    fl_can_frame_t f = {fl_identifier_pack((fl_identifier_t){OWN_ID, command, r->uid, 0}), len, {0}};
    const int32_t words[2] = {first, second};
    memcpy(f.data, words, sizeof words);
    fl_positioner_receive(p, &f);
    return r->last_code;
}

static int32_t nearby(rig_t *r, const fl_positioner_t *p, int axis) {
    const int32_t way = (int32_t)(random_u32(r) % (2 * NEAR_CNT)) - NEAR_CNT;
    return fl_add_i32(p->axis[axis].position_cnt, way);
}

static void load_path(rig_t *r, fl_positioner_t *p) {
    int32_t goal[FL_AXES];
    for (int i = 0; i < FL_AXES; ++i) goal[i] = nearby(r, p, i);
    ask(r, p, 10, 2, 2, 8);
    for (int i = 0; i < FL_AXES; ++i) {
        ask(r, p, 11, p->axis[i].position_cnt, 200, 8);
        ask(r, p, 11, goal[i], 200 + (int32_t)(random_u32(r) % 1000), 8);
    }
    ask(r, p, 12, 0, 0, 0);
}

/* What a host does that has lost the datum: it searches, or says where the camera sees it. */
static void recover(rig_t *r, fl_positioner_t *p) {
    ask(r, p, 15, 0, 0, 0);
    if (chance(r, 3)) {
        r->homed += ask(r, p, chance(r, 2) ? 20 : 23, 0, 0, 0) == FL_ACCEPTED;
        return;
    }
    ask(r, p, 33, fl_add_i32(r->rotor_cnt[0], r->zero_cnt[0]), fl_add_i32(r->rotor_cnt[1], r->zero_cnt[1]),
        8);
}

static void command(rig_t *r, fl_positioner_t *p) {
    switch (random_u32(r) % 8) {
    case 0:
    case 1:
        r->refused += ask(r, p, 30, nearby(r, p, 0), nearby(r, p, 1), 8) == FL_INVALID_COMMAND;
        return;
    case 2:
        load_path(r, p);
        if (chance(r, 2))
            fl_positioner_sync(p);
        else
            r->refused += ask(r, p, 14, 0, 0, 0) == FL_INVALID_COMMAND;
        return;
    case 3:
        ask(r, p, chance(r, 2) ? 13 : 15, 0, 0, 0);
        return;
    case 4:
        recover(r, p);
        return;
    case 5:
        ask(r, p, 53, 0, 0, 0);
        return;
    default:
        ask(r, p, 3, 0, 0, 0);
    }
}

/* -- what happens to it ------------------------------------------------------------------------------ */

static bool known(const fl_positioner_t *p) {
    const uint64_t datums = FL_STATUS(DATUM_ALPHA_INITIALIZED) | FL_STATUS(DATUM_BETA_INITIALIZED);
    return (p->status & datums) == datums;
}

static void power_up(rig_t *r, fl_positioner_t *p) {
#define X(name, unit, min, max, def, doc) .name = (float)(def),
    const fl_axis_params_t one = {FL_AXIS_PARAMS(X)};
#undef X
    const fl_axis_params_t params[FL_AXES] = {one, one};
    const fl_port_t port = {r, read_hall, set_phases, send_frame, storage_read, storage_write, NULL, NULL};
    r->dead = r->held = r->mailbox_full = false;
    fl_positioner_init(p, &port, OWN_ID, params);
}

static void cut_power(rig_t *r, fl_positioner_t *p) {
    r->cuts_in_motion += p->state > FL_STATE_REFUSED;
    r->cuts_in_write += r->dead;
    ++r->cuts;
    power_up(r, p);
    r->known_after_cut += known(p);
}

static void misbehave(rig_t *r, fl_positioner_t *p) {
    switch (random_u32(r) % 8) {
    case 0:
        r->held = !r->held;
        return;
    case 1:
        r->mailbox_full = !r->mailbox_full;
        return;
    case 2:
        r->write_budget = random_u32(r) % 100;
        r->fails_at_cut = chance(r, 2);
        return;
    case 3:
    case 4:
        r->write_budget = UINT32_MAX;
        return;
    case 5:
        if (chance(r, 4)) fl_positioner_enter_bootloader(p);
        return;
    default:
        cut_power(r, p);
    }
}

static void let_tick(rig_t *r, fl_positioner_t *p, uint32_t ticks) {
    for (uint32_t t = 0; t < ticks && !r->dead; ++t) fl_positioner_tick(p);
}

/* A quarter of a turn of the motor: a count that is wrong is wrong by whole turns. */
static void check_place(const rig_t *r, const fl_positioner_t *p) {
    if (!known(p) || p->state == FL_STATE_HOMING || p->state == FL_STATE_DATUM_CALIBRATION) return;
    for (int i = 0; i < FL_AXES; ++i) {
        const int32_t true_cnt = fl_add_i32(r->rotor_cnt[i], r->zero_cnt[i]);
        const int32_t off = fl_sub_i32(p->axis[i].position_cnt, true_cnt);
        REQUIRE(off < FL_TURN_CNT / 4 && off > -FL_TURN_CNT / 4, "axis %d is %d counts off, state %d", i,
                (int)off, p->state);
    }
}

static void run(rig_t *r, uint64_t steps) {
    static fl_positioner_t p;
    power_up(r, &p);
    for (int i = 0; i < FL_AXES; ++i) {
        r->stop_cnt[i] = 0;
        r->zero_cnt[i] = fl_axis_datum_cnt(&p.axis[i]);
        r->rotor_cnt[i] = HOME_CNT;
    }
    for (uint64_t n = 0; n < steps; ++n) {
        const bool moved = p.state > FL_STATE_REFUSED;
        if (chance(r, 3)) command(r, &p);
        if (chance(r, 12)) misbehave(r, &p);
        let_tick(r, &p, chance(r, 20) ? random_u32(r) % STOPPED_TICKS / 4 : random_u32(r) % 40);
        if (r->dead) cut_power(r, &p);
        r->arrived += moved && p.state == FL_STATE_IDLE;
        check_place(r, &p);
    }
}

int main(int argc, char **argv) {
    static rig_t rig;
    const uint64_t steps = argc > 1 ? strtoull(argv[1], NULL, 10) : 1000000;
    const uint64_t seed = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
    rig.random = seed * 0x9e3779b97f4a7c15u + 1;
    rig.write_budget = UINT32_MAX;
    memset(rig.storage, 0xff, sizeof rig.storage);
    run(&rig, steps);
    if (steps >= 100000)
        REQUIRE(rig.cuts_in_motion && rig.cuts_in_write && rig.known_after_cut && rig.refused && rig.homed &&
                    rig.arrived,
                "something never happened");
    printf("check_sequences: %llu steps, seed %llu: %llu power cuts, %llu in motion, %llu in a write; known "
           "after "
           "%llu of them; %llu motions refused, %llu datum searches, %llu motions ended: no finding\n",
           (unsigned long long)steps, (unsigned long long)seed, (unsigned long long)rig.cuts,
           (unsigned long long)rig.cuts_in_motion, (unsigned long long)rig.cuts_in_write,
           (unsigned long long)rig.known_after_cut, (unsigned long long)rig.refused,
           (unsigned long long)rig.homed, (unsigned long long)rig.arrived);
    return 0;
}
