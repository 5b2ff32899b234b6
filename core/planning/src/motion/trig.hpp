// Sine and cosine from additions and products alone, so that every platform gets the same bits
// (the C library's differ in the last one). Error below 2e-16 for |angle| < 100 rad.
#pragma once

#include <cmath>

namespace fl::planning {

struct Turn {
    double c = 1.0;
    double s = 0.0;
};

// Taylor series on [-pi/4, pi/4]: the first term left out is below 1e-18.
inline Turn small_turn(double x) {
    const double z = x * x;
    double s = 1.0, c = 1.0;
    for (int n = 17; n >= 3; n -= 2) s = 1.0 - s * (z * (1.0 / (n * (n - 1))));
    for (int n = 18; n >= 2; n -= 2) c = 1.0 - c * (z * (1.0 / (n * (n - 1))));
    return {c, x * s};
}

inline Turn turn(double angle_rad) {
    // pi/2 in two parts: the first has 33 bits, so that small multiples of it are exact
    constexpr double high = 1.57079632673412561417, low = 6.07710050650619224932e-11;
    const double count = std::floor(angle_rad / (high + low) + 0.5);
    const Turn t = small_turn((angle_rad - count * high) - count * low);
    switch (static_cast<long long>(count) & 3) {
    case 0:
        return t;
    case 1:
        return {-t.s, t.c};
    case 2:
        return {-t.c, -t.s};
    default:
        return {t.s, -t.c};
    }
}

// The turn by the sum of two angles.
inline Turn operator*(Turn a, Turn b) { return {a.c * b.c - a.s * b.s, a.s * b.c + a.c * b.s}; }

} // namespace fl::planning
