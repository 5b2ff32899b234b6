/* The hardware that check_dispatch gives the firmware: no physics, and it fails. */
#ifndef FUZZ_HARDWARE_H
#define FUZZ_HARDWARE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fl_identifier.h"
#include "fl_storage.h"
#include "params_model.h"
#include "sequence_model.h"

enum { OWN_ID = 77, IMAGE_MOST = 1 << 20, SCRIPT_MOST = 12 };

typedef struct bench {
    uint64_t random;
    uint32_t replies;
    uint64_t collisions, told; /* begun; frames 18. One that waits speaks for a second, too */
    uint64_t stops_when_full, watch_ends, unnoted;
    fl_can_frame_t last;
    float duty[FL_AXES][3];
    bool open[FL_AXES], opens; /* the bridges; whether this board can open them */
    uint64_t opened, not_opened;
    uint16_t hall[FL_AXES][2];
    int32_t rotor_cnt[FL_AXES];
    bool stuck, mailbox_full;
    uint8_t storage[FL_STORAGE_BYTES];
    uint32_t write_budget;
    sequence_model_t model;
    uint32_t image_crc, image_left, image_expected; /* of the image under way, reckoned here */
    uint64_t images_good, images_bad, drives;
    params_model_t params; /* of the parameters, as the traffic tells */
    uint64_t commits_good, commits_bad;
    uint64_t codes[256][16];
} bench_t;

static uint32_t random_u32(bench_t *b) {
    b->random ^= b->random << 13;
    b->random ^= b->random >> 7;
    b->random ^= b->random << 17;
    return (uint32_t)(b->random >> 32);
}

static bool chance(bench_t *b, uint32_t one_in) { return random_u32(b) % one_in == 0; }

#define REQUIRE(condition, ...)                                                                              \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "check_dispatch: " __VA_ARGS__);                                                 \
            fprintf(stderr, " (%s)\n", #condition);                                                          \
            exit(1);                                                                                         \
        }                                                                                                    \
    } while (0)

/* -- a port without physics: the rotor follows the field at once, when the sensor lives ------------- */

static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    bench_t *b = ctx;
    if (!b->stuck) {
        const fl_sincos_t v = fl_sincos_cnt(b->rotor_cnt[axis]);
        b->hall[axis][0] = (uint16_t)(2048.0f + 1500.0f * v.sin);
        b->hall[axis][1] = (uint16_t)(2048.0f + 1500.0f * v.cos);
    }
    memcpy(adc_cnt, b->hall[axis], sizeof b->hall[axis]);
}

static void set_phases(void *ctx, int axis, const float duty[3]) {
    bench_t *b = ctx;
    b->open[axis] = false;
    for (int i = 0; i < 3; ++i) {
        REQUIRE(duty[i] >= 0.0f && duty[i] <= 1.0f, "duty %g", (double)duty[i]);
        b->duty[axis][i] = duty[i];
    }
    /* a third of a turn at most, towards the field */
    const float u_cos = duty[2] - 0.5f * (duty[0] + duty[1]), u_sin = duty[1] - duty[0];
    const int32_t field = fl_atan2_cnt(u_sin, u_cos);
    const bool on = u_cos != 0.0f || u_sin != 0.0f;
    REQUIRE(!on || sequence_may_drive(&b->model), "axis %d is driven without a sequence", axis);
    b->drives += on;
    if (on)
        b->rotor_cnt[axis] =
            fl_add_i32(b->rotor_cnt[axis], fl_fold_cnt(fl_sub_i32(field, b->rotor_cnt[axis])) / 64);
}

static void open_phases(void *ctx, int axis) {
    bench_t *b = ctx;
    REQUIRE(sequence_may_drive(&b->model), "bridge %d is opened without a sequence", axis);
    memset(b->duty[axis], 0, sizeof b->duty[axis]);
    b->open[axis] = true;
    ++b->opened;
}

/* Frame 18. A request of that number is refused: its answer has a code. */
static bool is_report(const fl_can_frame_t *f) {
    const fl_identifier_t id = fl_identifier_unpack(f->id);
    return id.command == FL_ID_COLLISION && id.code == 0;
}

static bool send_frame(void *ctx, const fl_can_frame_t *f) {
    bench_t *b = ctx;
    if (b->mailbox_full) return false;
    REQUIRE(f->len <= 8 && f->id >> 29 == 0, "frame %08x of %d bytes", (unsigned)f->id, f->len);
    REQUIRE(fl_identifier_unpack(f->id).positioner == OWN_ID, "sender %08x", (unsigned)f->id);
    if (is_report(f)) {
        REQUIRE(++b->told <= b->collisions, "a collision is told twice");
        return true;
    }
    ++b->replies;
    b->last = *f;
    return true;
}

static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    bench_t *b = ctx;
    if (offset + len > sizeof b->storage) return 0;
    memcpy(bytes, b->storage + offset, len);
    return len;
}

static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    bench_t *b = ctx;
    if (offset + len > sizeof b->storage) return 0;
    const uint32_t n = len < b->write_budget ? len : b->write_budget;
    memcpy(b->storage + offset, bytes, n);
    b->write_budget -= n;
    return n;
}

static uint32_t image_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    static uint8_t image[IMAGE_MOST];
    bench_t *b = ctx;
    REQUIRE(len <= 8 && offset + len <= sizeof image, "image bytes %u at %u", len, offset);
    memcpy(image + offset, bytes, len);
    return chance(b, 500) ? 0 : len;
}

#endif
