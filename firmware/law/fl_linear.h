/* Square root and small linear systems for the calibrations: bounded loops, no libm. */
#ifndef FL_LINEAR_H
#define FL_LINEAR_H

#include "fl_math.h"

/* Newton's iteration from an exponent-halving guess; x <= 0 gives 0. Relative error 2e-7. */
static inline float fl_sqrt(float x) {
    if (!(x > 0.0f)) return 0.0f;
    union {
        float f;
        uint32_t u;
    } guess = {x};
    guess.u = (guess.u >> 1) + 0x1fbd1df5u;
    float r = guess.f;
    for (int i = 0; i < 4; ++i) r = 0.5f * (r + x / r);
    return r;
}

enum { FL_FIT_SIZE = 5 };

/* Normal equations of a least-squares fit with up to five unknowns. */
typedef struct fl_normal {
    float m[FL_FIT_SIZE][FL_FIT_SIZE + 1]; /* the right-hand side in column n */
} fl_normal_t;

/* Adds an observation: `value` is the sum of the n unknowns times `basis`.
 * @pre 1 <= n <= FL_FIT_SIZE, the same for all observations; all zero at first */
static inline void fl_normal_add(fl_normal_t *f, int n, const float *basis, float value) {
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) f->m[i][j] += basis[i] * basis[j];
        f->m[i][n] += basis[i] * value;
    }
}

/* Gauss without pivoting: the matrix is positive definite or the data are no good (false).
 * explained: how much of the sum of squared values the fit explains. */
static inline bool fl_normal_solve(fl_normal_t *f, int n, float *x, float *explained) {
    *explained = 0.0f;
    for (int k = 0; k < n; ++k) {
        if (!(f->m[k][k] > 1e-6f)) return false;
        *explained += f->m[k][n] * f->m[k][n] / f->m[k][k];
        for (int i = k + 1; i < n; ++i) {
            const float share = f->m[i][k] / f->m[k][k];
            for (int j = k; j <= n; ++j) f->m[i][j] -= share * f->m[k][j];
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        float sum = f->m[k][n];
        for (int j = k + 1; j < n; ++j) sum -= f->m[k][j] * x[j];
        x[k] = sum / f->m[k][k];
    }
    return true;
}

#endif
