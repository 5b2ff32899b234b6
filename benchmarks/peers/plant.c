/* The plant as an engineer would write it in plain C: structure of arrays, blocks that stay in the cache, and
 * the compiler's own vectors. Rotor, coils, cogging, friction and backlash; no firmware, sensors or
 * neighbours.
 *
 *     gcc -O3 -march=native -ffast-math -DREAL=float plant.c -lm && ./a.out AXES TICKS
 *
 * Prints ns per axis and tick of ten steps. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#ifndef REAL
#define REAL double
#endif
typedef REAL real;
enum { BLOCK = 64, STEPS = 10 };

typedef struct block {
    real theta[BLOCK], p[BLOCK], gear[BLOCK];
    real drive_sin[BLOCK], drive_cos[BLOCK], cog_sin[BLOCK], cog_cos[BLOCK];
    real backlash[BLOCK], scale[BLOCK], coulomb[BLOCK], resist_up[BLOCK], resist_down[BLOCK];
    real drag_free[BLOCK], drag_push[BLOCK], slow_free[BLOCK], slow_push[BLOCK], per_p_free[BLOCK],
        per_p_push[BLOCK];
} block_t;

static inline real most(real a, real b) { return a > b ? a : b; }
static inline real least(real a, real b) { return a < b ? a : b; }

static void step(block_t *restrict b) {
    for (int i = 0; i < BLOCK; ++i) {
        const real turns =
            (real)(int)(b->theta[i] * (real)0.6366197723675814 + (b->theta[i] < 0 ? (real)-0.5 : (real)0.5));
        const real r = b->theta[i] - turns * (real)1.5707963267948966, z = r * r;
        const real s0 =
            r + r * z * ((real)-1.6666654611e-1 + z * ((real)8.3321608736e-3 - z * (real)1.9515295891e-4));
        const real c0 = 1 - (real)0.5 * z + z * z * ((real)4.166664568e-2 - z * (real)1.38873163e-3);
        const int quarter = (int)turns;
        const real s1 = quarter & 1 ? c0 : s0, c1 = quarter & 1 ? s0 : c0;
        const real s = quarter & 2 ? -s1 : s1, c = (quarter + 1) & 2 ? -c1 : c1;
        const real s2 = 2 * s * c, c2 = 1 - 2 * s * s;
        const real torque =
            b->drive_sin[i] * s + b->drive_cos[i] * c - b->cog_sin[i] * s2 - b->cog_cos[i] * c2;
        const real below = (b->theta[i] - b->backlash[i]) * b->scale[i];
        const real gear = least(most(b->gear[i], below), b->theta[i]);
        const int up = below >= gear, down = b->theta[i] <= gear;
        const real force = b->p[i] + torque;
        const int pushing = (up & (force > 0)) | (down & (force < 0));
        const real slowed = force - (pushing ? b->drag_push[i] : b->drag_free[i]) * b->p[i];
        const real moved = most(slowed - b->coulomb[i] - (up ? b->resist_up[i] : 0), 0) +
                           least(slowed + b->coulomb[i] + (down ? b->resist_down[i] : 0), 0);
        b->p[i] = moved * (pushing ? b->slow_push[i] : b->slow_free[i]);
        b->gear[i] = gear;
        b->theta[i] += b->p[i] * (pushing ? b->per_p_push[i] : b->per_p_free[i]);
    }
}

static void set_up(block_t *b) {
    const real h = (real)5e-5, inertia = (real)3.4e-9;
    for (int i = 0; i < BLOCK; ++i) {
        b->theta[i] = b->gear[i] = (real)(0.01 * i);
        b->p[i] = (real)(209.0 * 3.4e-9);
        b->drive_sin[i] = h * (real)1e-4, b->drive_cos[i] = h * (real)1e-4;
        b->cog_sin[i] = h * (real)1e-5, b->cog_cos[i] = h * (real)1e-6;
        b->backlash[i] = (real)2.0, b->scale[i] = 1, b->coulomb[i] = h * (real)1e-6;
        b->resist_up[i] = b->resist_down[i] = h * (real)1.9e-5;
        b->drag_free[i] = b->drag_push[i] = (real)1e-3, b->slow_free[i] = b->slow_push[i] = (real)0.999;
        b->per_p_free[i] = h / inertia, b->per_p_push[i] = h / (inertia + (real)1e-10);
    }
}

int main(int argc, char **argv) {
    if (argc != 3) return 2;
    const int blocks = (atoi(argv[1]) + BLOCK - 1) / BLOCK, ticks = atoi(argv[2]);
    block_t *all = aligned_alloc(64, (sizeof(block_t) * (size_t)blocks + 63) / 64 * 64);
    for (int k = 0; k < blocks; ++k) set_up(all + k);
    const clock_t begin = clock();
    for (int tick = 0; tick < ticks; ++tick)
        for (int k = 0; k < blocks; ++k)
            for (int n = 0; n < STEPS; ++n) step(all + k);
    const double s = (double)(clock() - begin) / CLOCKS_PER_SEC;
    double sum = 0.0; /* somebody looks at the result */
    for (int k = 0; k < blocks; ++k) sum += (double)all[k].theta[0];
    fprintf(stderr, "%g\n", sum);
    printf("%.3f\n", 1e9 * s / ((double)blocks * BLOCK * ticks));
    return 0;
}
