/* No step of the firmware allocates: malloc and its kin abort while one runs. A move and the
 * calibrations from beginning to end, a save, an upgrade. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fl_dispatch.h"
#include "fl_identifier.h"
#include "fl_storage.h"

extern void *__libc_malloc(size_t);
extern void __libc_free(void *);
static bool guarded;

static void refuse(void) {
    if (!guarded) return;
    guarded = false;
    fputs("check_heap: the firmware allocates\n", stderr);
    abort();
}

void *malloc(size_t n) {
    refuse();
    return __libc_malloc(n);
}

void free(void *p) {
    refuse();
    __libc_free(p);
}

void *calloc(size_t n, size_t size) {
    void *p = malloc(n * size);
    return p ? memset(p, 0, n * size) : p;
}

void *realloc(void *old, size_t n) {
    (void)old, (void)n;
    refuse();
    return NULL;
}

static uint8_t storage[FL_STORAGE_BYTES];
static int32_t rotor_cnt[FL_AXES];

static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    (void)ctx;
    const fl_sincos_t v = fl_sincos_cnt(rotor_cnt[axis]);
    adc_cnt[0] = (uint16_t)(2048.0f + 1500.0f * v.sin);
    adc_cnt[1] = (uint16_t)(2048.0f + 1500.0f * v.cos);
}

static void set_phases(void *ctx, int axis, const float duty[3]) {
    (void)ctx;
    const int32_t field = fl_atan2_cnt(duty[1] - duty[0], duty[2] - 0.5f * (duty[0] + duty[1]));
    rotor_cnt[axis] += fl_fold_cnt(fl_sub_i32(field, rotor_cnt[axis])) / 64;
}

static void open_phases(void *ctx, int axis) { (void)ctx, (void)axis; }

static bool send_frame(void *ctx, const fl_can_frame_t *f) {
    (void)ctx, (void)f;
    return true;
}

static uint32_t storage_read(void *ctx, uint32_t offset, void *bytes, uint32_t len) {
    (void)ctx;
    memcpy(bytes, storage + offset, len);
    return len;
}

static uint32_t storage_write(void *ctx, uint32_t offset, const void *bytes, uint32_t len) {
    (void)ctx;
    memcpy(storage + offset, bytes, len);
    return len;
}

static void ask(fl_positioner_t *p, uint8_t command, int32_t a, int32_t b, uint8_t len) {
    fl_can_frame_t f = {fl_identifier_pack((fl_identifier_t){9, command, 1, 0}), len, {0}};
    memcpy(f.data, &a, sizeof a);
    memcpy(f.data + 4, &b, sizeof b);
    fl_positioner_receive(p, &f);
    for (int i = 0; i < 20000 && !fl_positioner_at_rest(p); ++i) fl_positioner_tick(p);
}

int main(void) {
    static fl_positioner_t p;
#define X(name, unit, min, max, def, doc) .name = (float)(def),
    const fl_axis_params_t one = {FL_AXIS_PARAMS(X)};
#undef X
    const fl_axis_params_t params[FL_AXES] = {one, one};
    const fl_port_t port = {NULL,         read_hall,     set_phases, send_frame,
                            storage_read, storage_write, NULL,       open_phases};
    const int32_t position[FL_AXES] = {30000000, 60000000};
    guarded = true;
    fl_positioner_init(&p, &port, 9, params);
    fl_positioner_set_position(&p, position);
    ask(&p, 30, 33000000, 57000000, 8);
    ask(&p, 245, (int32_t)0x80002000u, 100 << 16 | 20, 8); /* a push, then the open bridge */
    static const uint8_t alone[] = {15, 26, 15, 47, 15, 20, 15, 53, 3};
    for (unsigned i = 0; i < sizeof alone; ++i) ask(&p, alone[i], 0, 0, 0);
    fl_positioner_enter_bootloader(&p);
    ask(&p, 200, 8, 0, 8);
    ask(&p, 201, 1, 2, 8);
    guarded = false;
    puts("check_heap: no allocation");
    return 0;
}
