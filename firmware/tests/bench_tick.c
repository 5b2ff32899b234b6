/* What a control period costs: CPU nanoseconds per axis and tick, all axes in motion.
 *
 *   bench_tick [POSITIONERS [TICKS]]      default 500 positioners, 1000 ticks
 *
 * The sensors are a table look-up and the rotor is where the command is, so almost all of the
 * time is the firmware's. Best of twenty runs: the machine is seldom alone.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fl_dispatch.h"
#include "fl_identifier.h"
#include "fl_positioner.h"

enum { TABLE = 1024, RUNS = 20 };
static uint16_t table[TABLE];

typedef struct bench {
    int32_t rotor_cnt[FL_AXES];
    float sink;
} bench_t;

static void read_hall(void *ctx, int axis, uint16_t adc_cnt[2]) {
    const int32_t i = ((bench_t *)ctx)->rotor_cnt[axis] >> 10;
    adc_cnt[0] = table[i & (TABLE - 1)];
    adc_cnt[1] = table[(i + TABLE / 4) & (TABLE - 1)];
}

static void set_phases(void *ctx, int axis, const float duty[3]) { ((bench_t *)ctx)->sink += duty[axis]; }

static bool send_frame(void *ctx, const fl_can_frame_t *f) {
    (void)ctx, (void)f;
    return true;
}

static void ask(fl_positioner_t *p, uint8_t command, int32_t a, int32_t b) {
    fl_can_frame_t f = {fl_identifier_pack((fl_identifier_t){p->id, command, 1, 0}), 8, {0}};
    if (command == 12 || command == 14 || command == 15) f.len = 0;
    memcpy(f.data, &a, sizeof a);
    memcpy(f.data + 4, &b, sizeof b);
    fl_positioner_receive(p, &f);
}

/* Twenty seconds of straight lines of a tenth of a second. */
static void start(fl_positioner_t *p) {
    const int32_t begin[FL_AXES] = {1000000 * (p->id % 300), 700000 * (p->id % 200)};
    fl_positioner_set_position(p, begin);
    ask(p, 15, 0, 0);
    ask(p, 10, 200, 200);
    for (int axis = 0; axis < FL_AXES; ++axis)
        for (int k = 0; k < 200; ++k) ask(p, 11, begin[axis] + 3000000 * k, 200 * k);
    ask(p, 12, 0, 0);
    ask(p, 14, 0, 0);
}

static double run(fl_positioner_t *p, bench_t *b, int n, int ticks) {
    const clock_t from = clock();
    for (int t = 0; t < ticks; ++t)
        for (int i = 0; i < n; ++i) {
            fl_positioner_tick(&p[i]);
            for (int axis = 0; axis < FL_AXES; ++axis)
                b[i].rotor_cnt[axis] = p[i].axis[axis].command.position_cnt - p[i].axis[axis].zero_cnt;
        }
    return (double)(clock() - from) * (1e9 / CLOCKS_PER_SEC) / n / ticks / FL_AXES;
}

int main(int argc, char **argv) {
    const int n = argc > 1 ? atoi(argv[1]) : 500, ticks = argc > 2 ? atoi(argv[2]) : 1000;
    if (n < 1 || ticks < 1) return 2;
#define X(name, unit, min, max, def, doc) .name = (float)(def),
    const fl_axis_params_t one = {FL_AXIS_PARAMS(X)};
#undef X
    const fl_axis_params_t params[FL_AXES] = {one, one};
    for (int i = 0; i < TABLE; ++i) table[i] = (uint16_t)(2048.0f + 1500.0f * fl_sincos_cnt(i << 10).sin);
    fl_positioner_t *p = calloc((size_t)n, sizeof *p);
    bench_t *b = calloc((size_t)n, sizeof *b);
    if (!p || !b) return 1;
    double best = 1e9;
    for (int r = 0; r < RUNS; ++r) {
        for (int i = 0; i < n; ++i) {
            const fl_port_t port = {&b[i], read_hall, set_phases, send_frame, NULL, NULL, NULL, NULL};
            fl_positioner_init(&p[i], &port, (uint16_t)(1 + i % 2047), params);
            start(&p[i]);
        }
        const double took = run(p, b, n, ticks);
        if (took < best) best = took;
        if (p[0].state != FL_STATE_MOVING) return 1;
    }
    printf("bench_tick: %d positioners, %.1f ns per axis and tick, %zu bytes each\n", n, best, sizeof *p);
    free(p);
    free(b);
    return 0;
}
