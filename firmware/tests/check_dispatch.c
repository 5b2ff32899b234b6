/* Random and mutated frames through the dispatcher, on hardware that fails.
 *
 *   check_dispatch [FRAMES [SEED]]      default 5 million frames, seed 1
 *
 * Built with address and undefined-behaviour sanitizers by FIBERLOOM_CHECKS. Beside what they find,
 * checked after every frame: one reply for one request, and none for a frame that is not one; a
 * refusal changes nothing; duties are fractions; current flows, and rotors turn, only after a sequence of
 * accepted requests that a model written from the protocol alone (sequence_model.h) lets move; an image is
 * believed only if its bytes are those of its checksum; a stop is carried out and a collision told once,
 * whatever waits to be sent; parameters are those that a host which reads the answers expects, and nothing
 * but a calibration and the commands for it changes them; no bridge is open at rest, or on a board without.
 */
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fl_calibration.h"
#include "fl_commands.h"
#include "fl_crc.h"
#include "fl_dispatch.h"
#include "fl_identifier.h"
#include "fl_status.h"
#include "fl_storage.h"
#include "fuzz_hardware.h"

static void power_up(bench_t *b, fl_positioner_t *p, const fl_axis_params_t params[FL_AXES]) {
    b->opens = !chance(b, 2);
    memset(b->open, 0, sizeof b->open); /* the hardware is off */
    const fl_port_t port = {b,
                            read_hall,
                            set_phases,
                            send_frame,
                            storage_read,
                            storage_write,
                            NULL,
                            b->opens ? open_phases : NULL};
    sequence_power_up(&b->model);
    b->collisions = b->told;
    fl_positioner_init(p, &port, OWN_ID, params);
    memcpy(b->params.now, p->params, sizeof p->params);
    b->params.begun = false;
    p->boot.image_write = image_write;
}

/* -- frames ----------------------------------------------------------------------------------------- */

static uint8_t any_command(bench_t *b) {
    unsigned n;
    const fl_command_row_t *rows = fl_command_table(&n);
    return chance(b, 8) ? (uint8_t)random_u32(b) : rows[random_u32(b) % n].number;
}

/* Values that mean something more often than random bits would. */
static uint32_t any_value(bench_t *b) {
    switch (random_u32(b) % 6) {
    case 0:
        return random_u32(b) % 4;
    case 1:
        return random_u32(b) % 1200;
    case 2:
        return random_u32(b) % 1100000000u;
    case 3:
        return 0u - random_u32(b) % 20000000u;
    case 4:
        return random_u32(b) % 6000u * 200u;
    default:
        return random_u32(b);
    }
}

static fl_can_frame_t any_frame(bench_t *b) {
    fl_can_frame_t f;
    fl_identifier_t id = {OWN_ID, any_command(b), (uint8_t)(1 + random_u32(b) % 63), 0};
    if (chance(b, 10)) id.positioner = 0;
    if (chance(b, 50)) id.positioner = (uint16_t)random_u32(b);
    if (chance(b, 50)) id.code = (uint8_t)random_u32(b);
    f.id = fl_identifier_pack(id);
    if (chance(b, 100)) f.id = random_u32(b);
    const fl_command_row_t *row = fl_command_find(id.command);
    f.len = row ? row->len_max : 8;
    if (chance(b, 10)) f.len = (uint8_t)(random_u32(b) % 9);
    if (chance(b, 1000)) f.len = (uint8_t)random_u32(b);
    for (int i = 0; i < 2; ++i) {
        const uint32_t v = any_value(b);
        memcpy(f.data + 4 * i, &v, sizeof v);
    }
    return f;
}

static fl_can_frame_t request(uint8_t command, uint8_t uid) {
    fl_can_frame_t f = {fl_identifier_pack((fl_identifier_t){OWN_ID, command, uid, 0}), 0, {0}};
    f.len = fl_command_find(command)->len_max;
    return f;
}

/* A bit of a valid frame turns over: of its payload, its identifier or its length. */
static void mutate(bench_t *b, fl_can_frame_t *f) {
    const uint32_t bit = random_u32(b) % (64 + 29 + 4);
    if (bit < 64)
        f->data[bit / 8] ^= (uint8_t)(1u << bit % 8);
    else if (bit < 64 + 29)
        f->id ^= 1u << (bit - 64);
    else
        f->len ^= (uint8_t)(1u << (bit - 64 - 29));
}

/* Any frame of a valid sequence may be left out, doubled or mutated. */
static uint32_t spoil(bench_t *b, const fl_can_frame_t *in, uint32_t count, fl_can_frame_t *out) {
    uint32_t n = 0;
    for (uint32_t k = 0; k < count; ++k) {
        fl_can_frame_t f = in[k];
        if (chance(b, 20)) mutate(b, &f);
        if (chance(b, 25)) continue;
        out[n++] = f;
        if (n < SCRIPT_MOST && chance(b, 50)) out[n++] = f;
        if (n == SCRIPT_MOST) break;
    }
    return n;
}

/* A small image with its checksum, in bites of up to eight bytes. */
static uint32_t image_script(bench_t *b, fl_can_frame_t *out) {
    uint8_t image[40];
    const uint32_t size = 1 + random_u32(b) % sizeof image;
    for (uint32_t i = 0; i < size; ++i) image[i] = (uint8_t)random_u32(b);
    const uint32_t crc = fl_crc_end(fl_crc_add(FL_CRC_START, image, size));
    out[0] = request(200, 1);
    memcpy(out[0].data, &size, 4);
    memcpy(out[0].data + 4, &crc, 4);
    uint32_t n = 1;
    for (uint32_t at = 0; at < size; at += 8, ++n) {
        out[n] = request(201, (uint8_t)n);
        out[n].len = (uint8_t)(size - at < 8 ? size - at : 8);
        memcpy(out[n].data, image + at, out[n].len);
    }
    return n;
}

/* Stop, then a move of one frame: a go-to nearby or a calibration. */
static uint32_t move_script(bench_t *b, fl_can_frame_t *out) {
    static const uint8_t moves[] = {20, 23, 26, 30, 31, 31, 47, 245};
    out[0] = request(15, 1);
    out[1] = request(moves[random_u32(b) % sizeof moves], 2);
    int32_t way[2] = {(int32_t)(random_u32(b) % 200000u), (int32_t)(random_u32(b) % 200000u)};
    if (chance(b, 3)) { /* a push, then the open bridge */
        out[1] = request((uint8_t)(245 + random_u32(b) % FL_AXES), 2);
        way[0] = (int32_t)(0x80000000u | random_u32(b) % 0x7fffu);
        way[1] = (int32_t)((random_u32(b) % 410u) << 16 | random_u32(b) % 4u);
    }
    memcpy(out[1].data, way, sizeof way);
    return 2;
}

/* A value of the table: near the one in force, or anywhere in its range. */
static float param_value(bench_t *b, const fl_positioner_t *p, int axis, uint8_t index) {
    const float now = ((const float *)&p->params[axis])[index];
    if (chance(b, 12))
        return params_range[index][0] +
               (params_range[index][1] - params_range[index][0]) * (float)(random_u32(b) % 1000) * 1e-3f;
    return now * (0.95f + 1e-4f * (float)(random_u32(b) % 1000));
}

/* A copy is begun, some values are set, all take effect. The checksum is of what the script meant to set. */
static uint32_t params_script(bench_t *b, const fl_positioner_t *p, fl_can_frame_t *out) {
    fl_axis_params_t meant[FL_AXES] = {p->params[FL_ALPHA], p->params[FL_BETA]};
    const uint32_t table = fl_params_table_crc();
    out[0] = request(15, 1);
    out[1] = request(231, 2);
    memcpy(out[1].data, &table, sizeof table);
    const uint32_t sets = 1 + random_u32(b) % 6;
    for (uint32_t k = 0; k < sets; ++k) {
        const int axis = (int)(random_u32(b) % FL_AXES);
        const uint8_t index = (uint8_t)(random_u32(b) % PARAMS);
        const float value = param_value(b, p, axis, index);
        out[2 + k] = request((uint8_t)(232 + axis), (uint8_t)(3 + k));
        out[2 + k].data[0] = index;
        memcpy(out[2 + k].data + 1, &value, sizeof value);
        ((float *)&meant[axis])[index] = value;
    }
    const uint32_t crc = fl_crc_end(fl_crc_add(FL_CRC_START, meant, sizeof meant));
    out[2 + sets] = request(234, 20);
    memcpy(out[2 + sets].data, &crc, sizeof crc);
    out[3 + sets] = request((uint8_t)(235 + random_u32(b) % 2), 21);
    out[3 + sets].data[0] = (uint8_t)(random_u32(b) % 50);
    return 4 + sets;
}

/* A small trajectory from here. */
static uint32_t path_script(bench_t *b, const fl_positioner_t *p, fl_can_frame_t *out) {
    static const uint8_t commands[7] = {15, 10, 11, 11, 12, 14, 3};
    for (int k = 0; k < 7; ++k) {
        fl_can_frame_t f = request(commands[k], (uint8_t)(k + 1));
        int32_t v[2] = {1, 1};
        if (commands[k] == 11) {
            v[0] = fl_add_i32(p->axis[k == 3].position_cnt, (int32_t)(random_u32(b) % 100000u));
            v[1] = (int32_t)(random_u32(b) % 2000u);
        }
        memcpy(f.data, v, sizeof v);
        out[k] = f;
    }
    return 7;
}

static uint32_t script(bench_t *b, const fl_positioner_t *p, fl_can_frame_t out[SCRIPT_MOST]) {
    fl_can_frame_t whole[SCRIPT_MOST];
    uint32_t count;
    if (p->state == FL_STATE_BOOTLOADER)
        count = image_script(b, whole);
    else if (chance(b, 12))
        count = params_script(b, p, whole);
    else if (chance(b, 3))
        count = move_script(b, whole);
    else
        count = path_script(b, p, whole);
    return spoil(b, whole, count, out);
}

/* -- checks ----------------------------------------------------------------------------------------- */

/* Everything but the ring of sent frames. */
static bool same(const fl_positioner_t *a, const fl_positioner_t *b) {
    const size_t begin = offsetof(fl_positioner_t, tx), end = begin + sizeof a->tx;
    return memcmp(a, b, begin) == 0 &&
           memcmp((const char *)a + end, (const char *)b + end, sizeof *a - end) == 0;
}

static bool is_request(const fl_positioner_t *p, const fl_can_frame_t *f) {
    const fl_identifier_t id = fl_identifier_unpack(f->id);
    return f->id >> 29 == 0 && f->len <= 8 && id.code == 0 && (id.positioner == 0 || id.positioner == p->id);
}

static void check_current(const bench_t *b, const fl_positioner_t *p) {
    for (int i = 0; i < FL_AXES; ++i) {
        const float *d = b->duty[i];
        const bool on = d[0] != 0.0f || d[1] != 0.0f || d[2] != 0.0f;
        const bool may = !fl_axis_rests(&p->axis[i]) || p->axis[i].voltage > 0.0f;
        REQUIRE(!on || may, "current in axis %d, state %d", i, p->state);
        REQUIRE(!b->open[i] || !fl_axis_rests(&p->axis[i]), "axis %d rests with an open bridge", i);
        REQUIRE(!fl_axis_rests(&p->axis[i]) || p->axis[i].voltage >= 0.0f, "axis %d", i);
    }
    const bool active = p->state >= FL_STATE_MOVING && p->state < FL_STATE_BOOTLOADER;
    const bool results = p->chores & (FL_CHORE_RESULT_ALPHA | FL_CHORE_RESULT_BETA);
    const bool rests = fl_axis_rests(&p->axis[0]) && fl_axis_rests(&p->axis[1]) && !results;
    REQUIRE(active == !rests, "state %d with axes %s", p->state, rests ? "at rest" : "moving");
}

/* What an image's own bytes say of it, against what the bootloader made of them. */
static void follow_image(bench_t *b, const fl_positioner_t *p, const fl_can_frame_t *f, uint8_t command) {
    uint32_t word[2];
    memcpy(word, f->data, sizeof word);
    if (command == 200) {
        b->image_left = word[0];
        b->image_expected = word[1];
        b->image_crc = FL_CRC_START;
        return;
    }
    REQUIRE(command != 201 || f->len <= b->image_left, "image longer than announced");
    b->image_crc = fl_crc_add(b->image_crc, f->data, f->len);
    b->image_left -= f->len;
    const bool good = b->image_left == 0 && fl_crc_end(b->image_crc) == b->image_expected;
    REQUIRE(((p->boot.status & FL_BOOT_CHECK_OK) != 0) == good, "an image believed or not, %08x",
            (unsigned)p->boot.status);
    b->images_good += good;
}

/* A motion that the storage cannot note is refused, and what is loaded is dropped. */
static bool not_noted(const fl_positioner_t *p, fl_identifier_t told) {
    const bool sets_out = sequence_moves(told.command) || told.command == 14;
    return told.code == FL_INVALID_COMMAND && sets_out && (p->status & FL_STATUS(STORAGE_FAILED));
}

/* The model follows what was carried out, as a host would that reads the answers. */
static void conclude(bench_t *b, const fl_positioner_t *p, const fl_can_frame_t *f,
                     const fl_can_frame_t *answer) {
    const fl_identifier_t told = fl_identifier_unpack(answer->id);
    uint32_t word[2];
    memcpy(word, f->data, sizeof word);
    const bool step = told.command == 245 || told.command == 246;
    const bool open = step && ((word[0] & 0xffffu) == 0x8000u || word[0] >> 16 == 0x8000u);
    b->not_opened += step && told.code == FL_UNKNOWN_COMMAND;
    REQUIRE(!(step && told.code == FL_UNKNOWN_COMMAND) || (open && !b->opens), "a torque step is unknown");
    REQUIRE(told.code != 0 || !open || b->opens, "a bridge that cannot be opened");
    if (told.code != 0) {
        sequence_refused(&b->model, told.command, told.code);
        if (not_noted(p, told)) sequence_drop(&b->model), ++b->unnoted;
        b->images_bad += told.command == 201;
        b->commits_bad += told.command == 234;
        return;
    }
    const bool current = word[0] != 0 || word[1] != 0;
    REQUIRE(sequence_accepted(&b->model, told.command, (uint64_t)word[0] + word[1], current),
            "%d was accepted out of sequence", told.command);
    REQUIRE(params_accepted(&b->params, p->params, f, told.command), "parameters by %d", told.command);
    b->commits_good += told.command == 234;
    if (told.command == 234)
        for (int i = 0; i < FL_AXES; ++i) sequence_hold(&b->model, b->params.now[i].holding_voltage);
    if (told.command == 200 || told.command == 201) follow_image(b, p, f, told.command);
    const bool rests = fl_axis_rests(&p->axis[0]) && fl_axis_rests(&p->axis[1]);
    REQUIRE(rests || b->model.driven || told.command == 13 || told.command == 15 ||
                p->state == FL_STATE_STOPPING,
            "an axis sets out at %d", told.command);
}

/* Answers that have not left yet. */
static uint32_t waiting(const fl_positioner_t *p) {
    uint32_t n = p->tx.waiting >> FL_URGENT_STOP & 1u;
    for (uint32_t i = 0; i < p->tx.count; ++i) {
        const fl_can_frame_t *f = &p->tx.frame[(p->tx.first + i) % FL_OUTBOX_FRAMES];
        n += !is_report(f);
    }
    return n;
}

/* The last of them. */
static const fl_can_frame_t *last_answer(const bench_t *b, const fl_positioner_t *p) {
    if (p->tx.waiting >> FL_URGENT_STOP & 1) return &p->tx.urgent[FL_URGENT_STOP];
    const uint32_t tail = (p->tx.first + p->tx.count + FL_OUTBOX_FRAMES - 1) % FL_OUTBOX_FRAMES;
    return p->tx.count != 0 ? &p->tx.frame[tail] : &b->last;
}

static bool is_stop(const fl_positioner_t *p, const fl_can_frame_t *f) {
    const uint8_t command = fl_identifier_unpack(f->id).command;
    return is_request(p, f) && (command == 13 || command == 15);
}

/* A request without room for its answer is not carried out, and a stop is: its answer waits outside, in place
 * of that of an older one. */
static uint32_t answers_due(bench_t *b, const fl_positioner_t *p, const fl_can_frame_t *f) {
    const bool room = p->tx.count < FL_OUTBOX_FRAMES || !b->mailbox_full;
    if (!is_request(p, f)) return 0;
    if (room) return 1;
    if (!is_stop(p, f)) return 0;
    ++b->stops_when_full;
    return p->tx.waiting >> FL_URGENT_STOP & 1 ? 0 : 1;
}

/* A good request to stop, to a unit that is not in the bootloader, ends all driving at once. */
static void check_stopped(const bench_t *b, const fl_positioner_t *p, const fl_can_frame_t *f) {
    const fl_identifier_t id = fl_identifier_unpack(f->id);
    const bool good = f->len == 0 && (id.positioner == p->id || id.command == 15);
    if (!is_stop(p, f) || !good || p->state == FL_STATE_BOOTLOADER) return;
    REQUIRE(!b->model.driven, "a stop was not carried out");
}

static void give(bench_t *b, fl_positioner_t *p, fl_positioner_t *before, const fl_can_frame_t *f) {
    const bool sampled = chance(b, 16); /* copying 14 KB is most of the work */
    if (sampled) memcpy(before, p, sizeof *p);
    const uint32_t due = answers_due(b, p, f), waited = waiting(p);
    const bool full = is_stop(p, f) && p->tx.count == FL_OUTBOX_FRAMES && b->mailbox_full;
    b->replies = 0;
    fl_positioner_receive(p, f);
    const uint32_t answered = b->replies + waiting(p) - waited;
    REQUIRE(answered == due, "%u replies to %08x", answered, (unsigned)f->id);
    if (sampled && is_request(p, f))
        before->heard_tick = p->heard_tick; /* a sign of life, whatever it says */
    if (answered == 1 || full) conclude(b, p, f, last_answer(b, p));
    check_stopped(b, p, f);
    if (answered == 1 && b->replies != 0) {
        const fl_identifier_t asked = fl_identifier_unpack(f->id), told = fl_identifier_unpack(b->last.id);
        ++b->codes[told.command][told.code];
        REQUIRE(told.command == asked.command && told.uid == asked.uid, "%08x for %08x", (unsigned)b->last.id,
                (unsigned)f->id);
        /* 12 may mark the trajectory refused, 201 ends a bad image: both are what the code tells; the storage
         * may have failed */
        const bool may =
            told.command == 12 || told.command == 201 || told.command == 33 || not_noted(p, told);
        REQUIRE(told.code == 0 || may || !sampled || same(before, p), "code %d of %d changed something",
                told.code, told.command);
        REQUIRE(told.code == 0 || b->last.len == 0, "a refusal with a payload");
    }
    REQUIRE(memcmp(p->params, b->params.now, sizeof p->params) == 0, "parameters changed by %08x",
            (unsigned)f->id);
    if (!is_request(p, f)) REQUIRE(!sampled || same(before, p), "a frame for others changed something");
    check_current(b, p);
}

static void misbehave(bench_t *b, fl_positioner_t *p, const fl_axis_params_t params[FL_AXES]) {
    if (chance(b, 200)) b->stuck = !b->stuck;
    if (chance(b, 50)) b->mailbox_full = !b->mailbox_full;
    if (chance(b, 300)) b->write_budget = random_u32(b) % 1000;
    if (chance(b, 20)) b->write_budget = UINT32_MAX;
    if (chance(b, 2000)) {
        fl_positioner_enter_bootloader(p);
        sequence_off(&b->model);
    }
    if (chance(b, 500)) {
        const bool may =
            p->state == FL_STATE_LOADED; /* a line without answer: the host sees what came of it */
        if (may) sequence_start(&b->model);
        fl_positioner_sync(p);
    }
    if (chance(b, 3000)) { /* power off, perhaps with a bit rotten */
        if (chance(b, 2)) b->storage[random_u32(b) % sizeof b->storage] ^= 1;
        memset(b->duty, 0, sizeof b->duty);
        power_up(b, p, params);
    }
    if (chance(b, 60) &&
        p->state <= FL_STATE_REFUSED) { /* flashed anew: drifting values would soon move nothing */
        memset(b->storage, 0xff, sizeof b->storage);
        for (int axis = 0; axis < FL_AXES; ++axis) fl_positioner_set_params(p, axis, &params[axis]);
        memcpy(b->params.now, p->params, sizeof p->params);
    }
    if (chance(b, 200)) {
        const int32_t position[FL_AXES] = {30000000, 60000000};
        if (p->state <= FL_STATE_REFUSED) fl_positioner_set_position(p, position);
    }
}

/* From the moment that all displacement is said to be completed nothing may drive the motors. */
static void let_tick(bench_t *b, fl_positioner_t *p) {
    const uint8_t state = p->state, collided = p->collided;
    const bool watched = !(p->status & FL_STATUS(HOST_TIMEOUT));
    /* one for which the queue has no room yet speaks for this one, too */
    const bool merged = b->mailbox_full && (p->tx.waiting >> FL_URGENT_COLLISION & 1);
    if (!merged) ++b->collisions;
    fl_positioner_tick(p);
    if (!merged && !(collided == 0 && p->collided != 0)) --b->collisions;
    REQUIRE(b->told <= b->collisions, "a collision is told that was none");
    REQUIRE(b->mailbox_full || b->told == b->collisions, "a collision is not told");
    b->watch_ends += watched && (p->status & FL_STATUS(HOST_TIMEOUT));
    /* their results */
    if (state == FL_STATE_HALL_CALIBRATION || state == FL_STATE_COGGING_CALIBRATION)
        memcpy(b->params.now, p->params, sizeof p->params);
    if (p->status & FL_STATUS(DISPLACEMENT_COMPLETED)) sequence_rests(&b->model);
}

/* A rotor that nothing turns: motion becomes a collision, at a full queue as often as not. */
static void hold(bench_t *b, fl_positioner_t *p) {
    static fl_positioner_t before;
    const bool was = b->stuck;
    b->stuck = true;
    b->mailbox_full = chance(b, 2);
    const fl_can_frame_t poll = request(3, 1);
    for (int k = 0; b->mailbox_full && k < FL_OUTBOX_FRAMES; ++k) give(b, p, &before, &poll);
    for (int t = 0; t < 400; ++t) let_tick(b, p);
    b->stuck = was;
}

static void run(bench_t *b, uint64_t frames) {
    static fl_positioner_t p, before;
#define X(name, unit, min, max, def, doc) .name = (float)(def),
    const fl_axis_params_t one = {FL_AXIS_PARAMS(X)};
#undef X
    fl_axis_params_t params[FL_AXES] = {one, one};
    params[FL_BETA].host_timeout_ms = 6.0f; /* shorter than some pauses between frames */
    power_up(b, &p, params);
    for (uint64_t n = 0; n < frames;) {
        fl_can_frame_t f[SCRIPT_MOST];
        uint32_t count = 1;
        if (chance(b, 8))
            count = script(b, &p, f);
        else
            f[0] = any_frame(b);
        for (uint32_t i = 0; i < count; ++i, ++n) give(b, &p, &before, &f[i]);
        if (chance(b, 4)) {
            for (uint32_t t = random_u32(b) % 16; t > 0; --t) let_tick(b, &p);
            check_current(b, &p);
        }
        if (chance(b, 16)) misbehave(b, &p, params);
        if (p.state == FL_STATE_MOVING && chance(b, 20)) hold(b, &p);
    }
}

/* A fuzzer that is always refused finds nothing: every command must have been carried out. */
static void check_coverage(const bench_t *b) {
    unsigned n, refusals = 0;
    const fl_command_row_t *rows = fl_command_table(&n);
    for (unsigned i = 0; i < n; ++i) {
        const uint64_t *codes = b->codes[rows[i].number];
        REQUIRE(codes[FL_ACCEPTED] != 0 || rows[i].input == FL_IN_IMPOSSIBLE, "%d was never accepted",
                rows[i].number);
        for (int code = 1; code < 16; ++code) refusals += codes[code] != 0;
    }
    REQUIRE(b->drives != 0 && b->images_good != 0 && b->images_bad != 0, "nothing happened");
    REQUIRE(b->stops_when_full != 0 && b->told != 0 && b->watch_ends != 0, "no full queue, or no watch");
    REQUIRE(b->opened != 0 && b->not_opened != 0, "bridges open for %llu ticks, refused %llu times",
            (unsigned long long)b->opened, (unsigned long long)b->not_opened);
    REQUIRE(b->unnoted != 0, "every motion could be noted");
    REQUIRE(b->commits_good != 0 && b->commits_bad != 0, "no parameters were taken, or none refused");
    printf(
        "check_dispatch: all %u commands carried out, %u kinds of refusal seen; %llu phase voltages, all in "
        "sequence; %llu images believed; %llu collisions told, %llu stops at a full queue, %llu trajectories "
        "ended "
        "by the host watch, bridges open for %llu ticks\n",
        n - 1, refusals, (unsigned long long)b->drives, (unsigned long long)b->images_good,
        (unsigned long long)b->told, (unsigned long long)b->stops_when_full,
        (unsigned long long)b->watch_ends, (unsigned long long)b->opened);
}

int main(int argc, char **argv) {
    static bench_t bench;
    const uint64_t frames = argc > 1 ? strtoull(argv[1], NULL, 10) : 5000000;
    const uint64_t seed = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
    bench.random = seed * 0x9e3779b97f4a7c15u + 1;
    bench.write_budget = UINT32_MAX;
    memset(bench.storage, 0xff, sizeof bench.storage);
    run(&bench, frames);
    if (frames >= 1000000) check_coverage(&bench);
    printf("check_dispatch: %llu frames, seed %llu: no finding\n", (unsigned long long)frames,
           (unsigned long long)seed);
    return 0;
}
