#include "kernels.hpp"
#include "pixels.hpp"

#include <algorithm>

#if defined(__x86_64__) && defined(__gnu_linux__)
#define FL_CLONES __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#else
#define FL_CLONES
#endif
#define FL_INLINE __attribute__((always_inline)) inline

namespace fl::metrology {
namespace {

using Float8 = float __attribute__((vector_size(32)));
using Int8 = std::int32_t __attribute__((vector_size(32)));

FL_INLINE Float8 all(float v) { return Float8{v, v, v, v, v, v, v, v}; }

FL_INLINE Float8 load(const float *p) {
    Float8 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}

FL_INLINE void store(float *p, Float8 v) { std::memcpy(p, &v, sizeof v); }

// 1 where the comparison holds, 0 elsewhere
FL_INLINE Float8 unit(Int8 mask) { return reinterpret_cast<Float8>(mask & reinterpret_cast<Int8>(all(1.0f))); }

// The fitted region ends softly, for the same reason as below.
FL_INLINE Float8 window(Float8 q, float q_max) {
    const Float8 t = (all(q_max) - q) * all(5.0f / q_max);
    const Float8 floor = t > all(0.0f) ? t : all(0.0f);
    return floor < all(1.0f) ? floor : all(1.0f);
}

// 1 for a residual that noise explains, 0 for one that it cannot, one half at the bar. Smooth, because a pixel
// that a sharp bar lets in and out again keeps the iteration from ending.
FL_INLINE Float8 trust(Float8 square, Float8 bar) {
    const Float8 t = square / bar, t2 = t * t;
    return all(1.0f) / (all(1.0f) + t2 * t2);
}

// exp(x) for x <= 0 to 2e-7: 2^n by the exponent bits, the rest by a polynomial of degree 5 (Cephes expf).
FL_INLINE Float8 exp_negative(Float8 x) {
    x = x > all(-80.0f) ? x : all(-80.0f);
    const Float8 magic = all(12582912.0f); // 1.5 * 2^23: adding it rounds to an integer
    const Float8 shifted = x * all(1.44269504f) + magic;
    const Float8 n = shifted - magic;
    const Float8 r = (x - n * all(0.693359375f)) + n * all(2.12194440e-4f);
    Float8 p = all(1.9875691500e-4f);
    p = p * r + all(1.3981999507e-3f);
    p = p * r + all(8.3334519073e-3f);
    p = p * r + all(4.1665795894e-2f);
    p = p * r + all(1.6666665459e-1f);
    p = p * r + all(5.0000001201e-1f);
    p = p * r * r + r + all(1.0f);
    const Int8 power = (reinterpret_cast<Int8>(shifted) + (127 - 0x4B400000)) << 23;
    return p * reinterpret_cast<Float8>(power);
}

// Profile and its slope dm/dq: one exponential, the rest of the ladder by squaring.
FL_INLINE void profile_at(const Shape &shape, Float8 q, Float8 &value, Float8 &slope) {
    Float8 e = exp_negative(q * all(-1.0f / 32.0f)); // lambda = 16
    value = all(0.0f);
    slope = all(0.0f);
    float rate = -1.0f / 32.0f;
    for (int k = 5; k >= 0; --k) {
        const Float8 term = e * all(shape.amplitude[static_cast<std::size_t>(k)]);
        value += term;
        slope += term * all(rate);
        e = e * e;
        rate *= 2.0f;
    }
}

FL_INLINE Float8 ramp(float start) {
    return Float8{0, 1, 2, 3, 4, 5, 6, 7} + all(start);
}

template <class P>
FL_INLINE void scan(const std::byte *bytes, int width, const float *threshold, std::vector<int> &chunks) {
    using Key = typename P::Key;
    const auto *row = reinterpret_cast<const typename P::Raw *>(bytes);
    const int whole = width / chunk_px;
    for (int c = 0; c < whole; ++c) {
        const Key limit = static_cast<Key>(threshold[c]);
        const auto *p = row + c * chunk_px;
        unsigned char any = 0;
        for (int i = 0; i < chunk_px; ++i) any |= static_cast<unsigned char>(P::key(p[i]) > limit);
        if (any != 0) chunks.push_back(c);
    }
    if (whole * chunk_px < width) chunks.push_back(whole); // the rest is looked at pixel by pixel
}

FL_CLONES void scan_u16(const std::byte *r, int w, const float *t, std::vector<int> &c) {
    scan<PixelU16>(r, w, t, c);
}
FL_CLONES void scan_u16_fits(const std::byte *r, int w, const float *t, std::vector<int> &c) {
    scan<PixelU16Fits>(r, w, t, c);
}
FL_CLONES void scan_f32(const std::byte *r, int w, const float *t, std::vector<int> &c) {
    scan<PixelF32>(r, w, t, c);
}
FL_CLONES void scan_f32_fits(const std::byte *r, int w, const float *t, std::vector<int> &c) {
    scan<PixelF32Fits>(r, w, t, c);
}
FL_CLONES void scan_f64(const std::byte *r, int w, const float *t, std::vector<int> &c) {
    scan<PixelF64>(r, w, t, c);
}

FL_CLONES void accumulate(const Stamp &stamp, const Shape &shape, const State &state, const Judge &judge,
                          Float8 *sum) {
    using N = Normal;
    const Float8 flux = all(static_cast<float>(state.flux));
    const Float8 level = all(static_cast<float>(state.background));
    const Float8 two_xx = all(2.0f * shape.xx), two_yy = all(2.0f * shape.yy), xy = all(shape.xy);
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j - state.y));
        for (int i = 0; i < stamp.width; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = ramp(static_cast<float>(i - state.x));
            const Float8 qx = two_xx * dx + xy * dy, qy = two_yy * dy + xy * dx; // gradient of q
            const Float8 q = (qx * dx + qy * dy) * all(0.5f);
            Float8 p, slope;
            profile_at(shape, q, p, slope);
            const Float8 light = flux * p;
            const Float8 positive = light > all(0.0f) ? light : all(0.0f);
            const Float8 variance = load(&stamp.variance[at]) + positive * all(judge.inverse_gain);
            const Float8 residual = load(&stamp.value[at]) - light - level;
            const Float8 misfit = positive * all(judge.tolerance);
            const Float8 allowed = variance + misfit * misfit + all(judge.floor_variance);
            const Float8 inside = window(q, judge.q_max);
            const Float8 say = inside * load(&stamp.usable[at]);
            const Float8 good = say * trust(residual * residual, allowed * all(judge.cut * judge.cut));
            const Float8 weight = good / variance;
            const Float8 step = -flux * slope; // d light / d(x, y) = -flux slope grad q
            const Float8 gx = step * qx, gy = step * qy;
            const Float8 wr = weight * residual, wp = weight * p, wx = weight * gx, wy = weight * gy;
            sum[N::ff] += wp * p, sum[N::fx] += wp * gx, sum[N::fy] += wp * gy, sum[N::fb] += wp;
            sum[N::xx] += wx * gx, sum[N::xy] += wx * gy, sum[N::xb] += wx;
            sum[N::yy] += wy * gy, sum[N::yb] += wy, sum[N::bb] += weight;
            sum[N::sf] += wr * p, sum[N::sx] += wr * gx, sum[N::sy] += wr * gy, sum[N::sb] += wr;
            sum[N::chi2] += wr * residual, sum[N::pixels] += good, sum[N::left_out] += say - good;
            sum[N::light] += inside * p * p, sum[N::light_lost] += (inside - good) * p * p;
        }
    }
}

FL_CLONES void moments(const Stamp &stamp, const Shape &shape, float x, float y, Float8 *sum) {
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j) - y);
        for (int i = 0; i < stamp.width; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = ramp(static_cast<float>(i) - x);
            const Float8 q = all(shape.xx) * dx * dx + all(shape.xy) * dx * dy + all(shape.yy) * dy * dy;
            const Float8 wd = exp_negative(q * all(-0.5f)) * load(&stamp.value[at]) * load(&stamp.usable[at]);
            const Float8 wx = wd * dx, wy = wd * dy;
            sum[0] += wd, sum[1] += wx, sum[2] += wy;
            sum[3] += wx * dx, sum[4] += wx * dy, sum[5] += wy * dy;
        }
    }
}

// The ladder's rungs in the same units as profile_at: flux times exp(-q / (2 lambda_k)) times `norm`.
FL_INLINE void rungs_at(Float8 q, Float8 scale, Float8 *rung) {
    Float8 e = exp_negative(q * all(-1.0f / 32.0f));
    for (int k = 5; k >= 0; --k, e = e * e) rung[k] = e * scale;
}

FL_CLONES void ladder_sums(const Stamp &stamp, const Shape &shape, float norm, const State &state,
                           const Judge &judge, Float8 *sum) {
    const Float8 scale = all(static_cast<float>(state.flux) * norm);
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j - state.y));
        for (int i = 0; i < stamp.width; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = ramp(static_cast<float>(i - state.x));
            const Float8 q = all(shape.xx) * dx * dx + all(shape.xy) * dx * dy + all(shape.yy) * dy * dy;
            Float8 rung[6];
            rungs_at(q, scale, rung);
            Float8 model = all(0.0f);
            for (int k = 0; k < 6; ++k) model += rung[k] * all(shape.amplitude[k] / norm);
            const Float8 positive = model > all(0.0f) ? model : all(0.0f);
            const Float8 variance = load(&stamp.variance[at]) + positive * all(judge.inverse_gain);
            const Float8 value = load(&stamp.value[at]), residual = value - model;
            const Float8 misfit = positive * all(judge.tolerance);
            const Float8 allowed = variance + misfit * misfit + all(judge.floor_variance);
            const Float8 good = load(&stamp.usable[at]) * unit(q <= all(judge.q_max)) *
                                trust(residual * residual, allowed * all(judge.cut * judge.cut));
            const Float8 weight = good / variance;
            int n = 0;
            for (int a = 0; a < 6; ++a) {
                const Float8 wa = weight * rung[a];
                for (int b = a; b < 6; ++b) sum[n++] += wa * rung[b];
            }
            for (int a = 0; a < 6; ++a) sum[21 + a] += weight * rung[a] * value;
            const Float8 core = unit(q <= all(8.0f)) * weight / variance;
            sum[27] += core * (residual * residual - variance);
            sum[28] += core * model * model;
        }
    }
}

FL_CLONES void subtract(Stamp &stamp, const Shape &shape, float flux, float x, float y, float inverse_gain) {
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j) - y);
        for (int i = 0; i < stamp.width; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = ramp(static_cast<float>(i) - x);
            const Float8 q = all(shape.xx) * dx * dx + all(shape.xy) * dx * dy + all(shape.yy) * dy * dy;
            Float8 p, slope;
            profile_at(shape, q, p, slope);
            const Float8 light = all(flux) * p;
            const Float8 positive = light > all(0.0f) ? light : all(0.0f);
            store(&stamp.value[at], load(&stamp.value[at]) - light);
            store(&stamp.variance[at], load(&stamp.variance[at]) + positive * all(inverse_gain));
        }
    }
}

} // namespace

void bright_chunks(PixelType type, const std::byte *row, int width, const float *threshold,
                   std::vector<int> &chunks) {
    chunks.clear();
    switch (type) {
    case PixelType::U16: return scan_u16(row, width, threshold, chunks);
    case PixelType::U16Fits: return scan_u16_fits(row, width, threshold, chunks);
    case PixelType::F32: return scan_f32(row, width, threshold, chunks);
    case PixelType::F32Fits: return scan_f32_fits(row, width, threshold, chunks);
    case PixelType::F64: return scan_f64(row, width, threshold, chunks);
    }
}

void Stamp::resize(int x, int y, int w, int h) {
    x0 = x, y0 = y, height = h;
    width = (w + lanes - 1) / lanes * lanes;
    const std::size_t n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    value.assign(n, 0.0f);
    variance.assign(n, 1.0f);
    usable.assign(n, 0.0f);
}

Normal normal_equations(const Stamp &stamp, const Shape &shape, const State &state, const Judge &judge) {
    Float8 lanes[Normal::size] = {};
    accumulate(stamp, shape, state, judge, lanes);
    Normal normal;
    for (int k = 0; k < Normal::size; ++k)
        for (int i = 0; i < Stamp::lanes; ++i) normal.sum[static_cast<std::size_t>(k)] += lanes[k][i];
    return normal;
}

void subtract_profile(Stamp &stamp, const Shape &shape, double flux, double x, double y, float inverse_gain) {
    subtract(stamp, shape, static_cast<float>(flux), static_cast<float>(x), static_cast<float>(y), inverse_gain);
}

std::array<double, 6> weighted_moments(const Stamp &stamp, const Shape &shape, double x, double y) {
    Float8 lanes[6] = {};
    moments(stamp, shape, static_cast<float>(x), static_cast<float>(y), lanes);
    std::array<double, 6> sum{};
    for (std::size_t k = 0; k < 6; ++k)
        for (int i = 0; i < Stamp::lanes; ++i) sum[k] += lanes[k][i];
    return sum;
}

void add_ladder(const Stamp &stamp, const Shape &shape, float norm, const State &state, const Judge &judge,
                LadderSums &sums) {
    Float8 lanes[29] = {};
    ladder_sums(stamp, shape, norm, state, judge, lanes);
    for (std::size_t k = 0; k < sums.size(); ++k)
        for (int i = 0; i < Stamp::lanes; ++i) sums[k] += lanes[k][i];
}

} // namespace fl::metrology
