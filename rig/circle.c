/* Sine and cosine for the tables of the twin's gear, in place of the C library's: those of glibc and
 * newlib differ in the last bit, and with them everything that follows. Basic arithmetic of IEEE 754
 * gives the same bits on both sides; the error stays below 2e-16 for angles of a few turns.
 */
#include <math.h>

double sin(double x);
double cos(double x);

/* To a quarter turn either side of zero: pi/2 in two parts, the first with 33 bits. */
static int reduce(double x, double *rest) {
    const double round_magic = 6755399441055744.0; /* 1.5 * 2^52: shifts the fraction out */
    const double quarters = (x * 0.63661977236758134308 + round_magic) - round_magic;
    *rest = (x - quarters * 1.57079632673412561417) - quarters * 6.07710050650619224932e-11;
    return (int)quarters & 3;
}

/* Taylor: the first term left out is below 1e-17 at 45 degrees. */
static double sine_of(double r) {
    const double z = r * r;
    double sum = 0.0;
    for (int n = 17; n > 1; n -= 2) sum = z / (double)(-n * (n - 1)) * (1.0 + sum);
    return r + r * sum;
}

static double cosine_of(double r) {
    const double z = r * r;
    double sum = 0.0;
    for (int n = 18; n > 0; n -= 2) sum = z / (double)(-n * (n - 1)) * (1.0 + sum);
    return 1.0 + sum;
}

static double turned(double r, int quarter) {
    const double value = quarter & 1 ? cosine_of(r) : sine_of(r);
    return quarter & 2 ? -value : value;
}

double sin(double x) {
    double rest;
    const int quarter = reduce(x, &rest);
    return turned(rest, quarter);
}

double cos(double x) {
    double rest;
    const int quarter = reduce(x, &rest);
    return turned(rest, (quarter + 1) & 3);
}
