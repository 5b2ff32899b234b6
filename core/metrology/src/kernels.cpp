#include "kernels.hpp"
#include "machine.hpp"
#include "pixels.hpp"

#include <algorithm>
#include <type_traits>

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
FL_INLINE Float8 unit(Int8 mask) {
    return reinterpret_cast<Float8>(mask & reinterpret_cast<Int8>(all(1.0f)));
}

// The fitted region ends softly, for the same reason as below.
FL_INLINE Float8 window(Float8 q, Float8 q_max, Float8 steepness) {
    const Float8 t = (q_max - q) * steepness;
    const Float8 floor = t > all(0.0f) ? t : all(0.0f);
    return floor < all(1.0f) ? floor : all(1.0f);
}

// Trust in a pixel: 1 / (1 + t^4), t = square / bar. 1 for a residual that noise explains, 0 for one that it
// cannot, one half at the bar. Smooth, because a pixel that a sharp bar lets in and out again keeps the
// iteration from ending. This is its inverse.
FL_INLINE Float8 distrust(Float8 square, Float8 bar) {
    const Float8 t = square / bar, t2 = t * t;
    return all(1.0f) + t2 * t2;
}

// exp(x) for x <= 0 to 2e-7: 2^n by the exponent bits, the rest by a polynomial of degree 5 (Cephes expf).
FL_INLINE Float8 exp_negative(Float8 x) {
    x = x > all(-80.0f) ? x : all(-80.0f);
    const Float8 magic = all(12582912.0f); // 1.5 * 2^23: adding it rounds to an integer
    const Float8 shifted = x * all(1.44269504f) + magic;
    const Float8 n = shifted - magic;
    const Float8 r = (x - n * all(0.693359375f)) + n * all(2.12194440e-4f);
    // pairs side by side: the chain of dependent operations is what takes the time
    const Float8 r2 = r * r;
    const Float8 low = all(1.0f) + r, middle = all(5.0000001201e-1f) + all(1.6666665459e-1f) * r;
    const Float8 high = all(4.1665795894e-2f) + all(8.3334519073e-3f) * r;
    const Float8 top = all(1.3981999507e-3f) + all(1.9875691500e-4f) * r;
    const Float8 p = (low + r2 * middle) + (r2 * r2) * (high + r2 * top);
    const Int8 power = (reinterpret_cast<Int8>(shifted) + (127 - 0x4B400000)) << 23;
    return p * reinterpret_cast<Float8>(power);
}

// One spot's shape with every number in all lanes: set up once, outside the loops.
struct WideShape {
    Float8 xx, xy, yy, linear, square;
    Float8 amplitude[6], slope[6];
};

FL_INLINE void widen(const Shape &shape, WideShape &wide) {
    wide.xx = all(shape.xx), wide.xy = all(shape.xy), wide.yy = all(shape.yy);
    wide.linear = all(shape.linear), wide.square = all(shape.square);
    float rate = -1.0f;
    for (int k = 0; k < 6; ++k, rate *= 0.5f) {
        wide.amplitude[k] = all(shape.amplitude[k]);
        wide.slope[k] = all(shape.amplitude[k] * rate);
    }
}

// Profile and its slope dm/dq: one exponential, the rest of the ladder by squaring.
FL_INLINE void profile_at(const WideShape &shape, Float8 q, Float8 &value, Float8 &slope) {
    const Float8 bend = shape.square * q;
    Float8 e = exp_negative(q * (shape.linear + bend) * all(-1.0f / 32.0f)); // lambda = 16
    value = e * shape.amplitude[5], slope = e * shape.slope[5];
#pragma GCC unroll 5
    for (int k = 4; k >= 0; --k) {
        e = e * e;
        value += e * shape.amplitude[k], slope += e * shape.slope[k];
    }
    slope = slope * (shape.linear + bend + bend); // dt/dq
}

FL_INLINE Float8 ramp(float start) { return Float8{0, 1, 2, 3, 4, 5, 6, 7} + all(start); }

template <class P> struct Rows {
    const typename P::Raw *above, *row, *below;
};

// Marks the tops of a part of a row. `read` is P::key or, quicker, P::stored.
template <class P, auto read>
FL_INLINE void mark_tops(const Rows<P> &r, int from, int to, typename P::Key bar, unsigned char *top) {
    for (int i = from; i < to; ++i) {
        const auto v = read(r.row[i]);
        // written as "not higher", so that a neighbour that is not a number is no obstacle
        const bool is = (v > bar) & !(read(r.above[i - 1]) > v) & !(read(r.above[i]) > v) &
                        !(read(r.above[i + 1]) > v) & !(read(r.row[i - 1]) > v) & !(read(r.row[i + 1]) >= v) &
                        !(read(r.below[i - 1]) >= v) & !(read(r.below[i]) >= v) &
                        !(read(r.below[i + 1]) >= v);
        top[i - from] = static_cast<unsigned char>(is);
    }
}

// Whether one of the pixels that decide about tops is brighter than any light.
template <class P> FL_INLINE bool any_wild(const Rows<P> &r, int from, int to) {
    unsigned char any = 0;
    if constexpr (std::is_floating_point_v<typename P::Key>) {
        constexpr auto most = static_cast<typename P::Key>(most_adu);
        for (int i = from - 1; i <= to; ++i)
            any |= static_cast<unsigned char>((P::stored(r.above[i]) > most) | (P::stored(r.row[i]) > most) |
                                              (P::stored(r.below[i]) > most));
    }
    return any != 0;
}

template <class P>
FL_INLINE void peaks_in_chunk(const Rows<P> &r, int from, int to, float limit, std::vector<int> &out) {
    const auto bar = static_cast<typename P::Key>(limit);
    alignas(64) unsigned char top[chunk_px] = {};
    if (any_wild(r, from, to))
        mark_tops<P, P::key>(r, from, to, bar, top);
    else
        mark_tops<P, P::stored>(r, from, to, bar, top);
    for (int word = 0; word < chunk_px; word += 8) {
        std::uint64_t eight;
        std::memcpy(&eight, top + word, sizeof eight);
        for (; eight != 0; eight &= eight - 1) out.push_back(from + word + std::countr_zero(eight) / 8);
    }
}

template <class P>
FL_INLINE void scan(const Rows<P> &r, int width, const float *threshold, std::vector<int> &out) {
    using Key = typename P::Key;
    for (int c = 0; c * chunk_px < width; ++c) {
        const int begin = c * chunk_px, end = std::min(begin + chunk_px, width);
        const Key bar = static_cast<Key>(threshold[c]);
        unsigned char any = 0;
        fetch_behind<0>(&r.row[begin], chunk_px * sizeof(typename P::Raw));
        // as stored, which is quicker: a pixel that holds no light costs a second look, and is none
        for (int i = begin; i < end; ++i) any |= static_cast<unsigned char>(P::stored(r.row[i]) > bar);
        if (any != 0) peaks_in_chunk(r, std::max(begin, 1), std::min(end, width - 1), threshold[c], out);
    }
}

template <class P> Rows<P> rows_of(const ImageView &image, const RowPart &part) {
    const auto at = [&](int y) {
        return reinterpret_cast<const typename P::Raw *>(image.data + y * image.row_bytes) + part.x0;
    };
    return {at(part.y - 1), at(part.y), at(part.y + 1)};
}

FL_CLONES void scan_u16(Rows<PixelU16> r, int w, const float *t, std::vector<int> &o) { scan(r, w, t, o); }
FL_CLONES void scan_u16_fits(Rows<PixelU16Fits> r, int w, const float *t, std::vector<int> &o) {
    scan(r, w, t, o);
}
FL_CLONES void scan_f32(Rows<PixelF32> r, int w, const float *t, std::vector<int> &o) { scan(r, w, t, o); }
FL_CLONES void scan_f32_fits(Rows<PixelF32Fits> r, int w, const float *t, std::vector<int> &o) {
    scan(r, w, t, o);
}
FL_CLONES void scan_f64(Rows<PixelF64> r, int w, const float *t, std::vector<int> &o) { scan(r, w, t, o); }

// The columns of one row that the ellipse q <= q_max covers, in whole lanes.
struct Span {
    int begin, end;
};

FL_INLINE Span covered(const Shape &shape, double x, double dy, float q_max, int width) {
    // xx dx^2 + xy dy dx + (yy dy^2 - q_max) = 0
    const double b = 0.5 * shape.xy * dy, root = b * b - shape.xx * (shape.yy * dy * dy - q_max);
    if (!(root > 0)) return {0, 0};
    const double half = std::sqrt(root) / shape.xx, middle = x - b / shape.xx;
    const int begin = whole(middle - half, 0, width) & ~(Stamp::lanes - 1);
    const int end = std::min(whole(middle + half, -1, width) + 1, width);
    return {begin, (end + Stamp::lanes - 1) & ~(Stamp::lanes - 1)};
}

// What `judge` says, in all lanes.
struct WideJudge {
    Float8 inverse_gain, tolerance, floor_variance, cut_square, q_max, steepness;
};

FL_INLINE void widen(const Judge &judge, WideJudge &wide) {
    wide.inverse_gain = all(judge.inverse_gain), wide.tolerance = all(judge.tolerance);
    wide.floor_variance = all(judge.floor_variance), wide.cut_square = all(judge.cut * judge.cut);
    wide.q_max = all(judge.q_max), wide.steepness = all(5.0f / judge.q_max);
}

FL_CLONES void accumulate(const Stamp &stamp, const Shape &narrow, const FitState &state,
                          const Judge &narrow_judge, Float8 *sum) {
    using N = Normal;
    WideShape shape;
    WideJudge judge;
    widen(narrow, shape), widen(narrow_judge, judge);
    const Float8 flux = all(static_cast<float>(state.flux)), minus_flux = -flux;
    const Float8 level = all(static_cast<float>(state.background));
    const Float8 two_xx = shape.xx + shape.xx, two_yy = shape.yy + shape.yy;
    const Float8 zero = all(0.0f), half = all(0.5f), columns = ramp(static_cast<float>(-state.x));
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j - state.y));
        const Span span = covered(narrow, state.x, j - state.y, narrow_judge.q_max, stamp.width);
        for (int i = span.begin; i < span.end; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = columns + static_cast<float>(i);
            const Float8 qx = two_xx * dx + shape.xy * dy, qy = two_yy * dy + shape.xy * dx; // gradient of q
            const Float8 q = (qx * dx + qy * dy) * half;
            Float8 p, slope;
            profile_at(shape, q, p, slope);
            const Float8 light = flux * p;
            const Float8 positive = light > zero ? light : zero;
            const Float8 variance = load(&stamp.variance[at]) + positive * judge.inverse_gain;
            const Float8 residual = load(&stamp.value[at]) - light - level;
            const Float8 misfit = positive * judge.tolerance;
            const Float8 allowed = variance + misfit * misfit + judge.floor_variance;
            const Float8 inside = window(q, judge.q_max, judge.steepness);
            const Float8 say = inside * load(&stamp.usable[at]);
            const Float8 doubt = distrust(residual * residual, allowed * judge.cut_square);
            const Float8 weight = say / (doubt * variance), good = weight * variance;
            const Float8 step = minus_flux * slope; // d light / d(x, y) = -flux slope grad q
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

constexpr float weightless_q = 30.0f; // exp(-q / 2) = 3e-7

FL_CLONES void moments(const Stamp &stamp, const Shape &shape, float x, float y, Float8 *sum) {
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j) - y);
        const Span span = covered(shape, x, static_cast<double>(j) - y, weightless_q, stamp.width);
        for (int i = span.begin; i < span.end; i += Stamp::lanes) {
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

// The ladder's rungs, flux * norm * exp(-t / (2 lambda_k)).
FL_INLINE void rungs_at(const WideShape &shape, Float8 q, Float8 scale, Float8 *rung) {
    Float8 e = exp_negative(q * (shape.linear + shape.square * q) * all(-1.0f / 32.0f));
#pragma GCC unroll 6
    for (int k = 5; k >= 0; --k, e = e * e) rung[k] = e * scale;
}

FL_CLONES void ladder_sums(const Stamp &stamp, const Shape &narrow, float norm, const FitState &state,
                           const Judge &narrow_judge, Float8 *sum) {
    WideShape shape;
    WideJudge judge;
    widen(narrow, shape), widen(narrow_judge, judge);
    for (Float8 &a : shape.amplitude) a /= all(norm);
    const Float8 scale = all(static_cast<float>(state.flux) * norm), zero = all(0.0f), core_q = all(8.0f);
    const Float8 columns = ramp(static_cast<float>(-state.x));
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j - state.y));
        const Span span = covered(narrow, state.x, j - state.y, narrow_judge.q_max, stamp.width);
        for (int i = span.begin; i < span.end; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = columns + static_cast<float>(i);
            const Float8 q = (shape.xx * dx + shape.xy * dy) * dx + shape.yy * dy * dy;
            Float8 rung[6];
            rungs_at(shape, q, scale, rung);
            Float8 model = rung[0] * shape.amplitude[0];
            for (int k = 1; k < 6; ++k) model += rung[k] * shape.amplitude[k];
            const Float8 positive = model > zero ? model : zero;
            const Float8 variance = load(&stamp.variance[at]) + positive * judge.inverse_gain;
            const Float8 value = load(&stamp.value[at]), residual = value - model;
            const Float8 misfit = positive * judge.tolerance;
            const Float8 allowed = variance + misfit * misfit + judge.floor_variance;
            const Float8 doubt = distrust(residual * residual, allowed * judge.cut_square);
            const Float8 weight = load(&stamp.usable[at]) / (doubt * variance);
            int n = 0;
            for (int a = 0; a < 6; ++a) {
                const Float8 wa = weight * rung[a];
                for (int b = a; b < 6; ++b) sum[n++] += wa * rung[b];
            }
            const Float8 wv = weight * value;
            for (int a = 0; a < 6; ++a) sum[21 + a] += wv * rung[a];
            const Float8 core = unit(q <= core_q) * weight / variance;
            sum[27] += core * (residual * residual - variance);
            sum[28] += core * model * model;
        }
    }
}

FL_CLONES void subtract(Stamp &stamp, const Shape &narrow, float flux, float x, float y, float inverse_gain) {
    WideShape shape;
    widen(narrow, shape);
    const Float8 columns = ramp(-x), zero = all(0.0f), wide_flux = all(flux), wide_gain = all(inverse_gain);
    for (int j = 0; j < stamp.height; ++j) {
        const Float8 dy = all(static_cast<float>(j) - y);
        for (int i = 0; i < stamp.width; i += Stamp::lanes) {
            const std::size_t at = static_cast<std::size_t>(j * stamp.width + i);
            const Float8 dx = columns + static_cast<float>(i);
            const Float8 q = (shape.xx * dx + shape.xy * dy) * dx + shape.yy * dy * dy;
            Float8 p, slope;
            profile_at(shape, q, p, slope);
            const Float8 light = wide_flux * p;
            const Float8 positive = light > zero ? light : zero;
            store(&stamp.value[at], load(&stamp.value[at]) - light);
            store(&stamp.variance[at], load(&stamp.variance[at]) + positive * wide_gain);
        }
    }
}

} // namespace

void row_peaks(const ImageView &image, const RowPart &part, const float *threshold, std::vector<int> &peaks) {
    peaks.clear();
    switch (image.type) {
    case PixelType::U16:
        return scan_u16(rows_of<PixelU16>(image, part), part.width, threshold, peaks);
    case PixelType::U16Fits:
        return scan_u16_fits(rows_of<PixelU16Fits>(image, part), part.width, threshold, peaks);
    case PixelType::F32:
        return scan_f32(rows_of<PixelF32>(image, part), part.width, threshold, peaks);
    case PixelType::F32Fits:
        return scan_f32_fits(rows_of<PixelF32Fits>(image, part), part.width, threshold, peaks);
    case PixelType::F64:
        return scan_f64(rows_of<PixelF64>(image, part), part.width, threshold, peaks);
    }
}

void Stamp::resize(int x, int y, int w, int h) {
    x0 = x, y0 = y, height = h;
    width = (w + lanes - 1) / lanes * lanes;
    const std::size_t n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    value.resize(n);
    variance.resize(n);
    usable.assign(n, 0.0f);
    if (width > w) std::fill(value.begin(), value.end(), 0.0f); // the padding must hold numbers
}

Normal normal_equations(const Stamp &stamp, const Shape &shape, const FitState &state, const Judge &judge) {
    Float8 lanes[Normal::size] = {};
    accumulate(stamp, shape, state, judge, lanes);
    Normal normal;
    for (int k = 0; k < Normal::size; ++k)
        for (int i = 0; i < Stamp::lanes; ++i) normal.sum[static_cast<std::size_t>(k)] += lanes[k][i];
    return normal;
}

void subtract_profile(Stamp &stamp, const Shape &shape, double flux, double x, double y, float inverse_gain) {
    subtract(stamp, shape, static_cast<float>(flux), static_cast<float>(x), static_cast<float>(y),
             inverse_gain);
}

std::array<double, 6> weighted_moments(const Stamp &stamp, const Shape &shape, double x, double y) {
    Float8 lanes[6] = {};
    moments(stamp, shape, static_cast<float>(x), static_cast<float>(y), lanes);
    std::array<double, 6> sum{};
    for (std::size_t k = 0; k < 6; ++k)
        for (int i = 0; i < Stamp::lanes; ++i) sum[k] += lanes[k][i];
    return sum;
}

void add_ladder(const Stamp &stamp, const Shape &shape, float norm, const FitState &state, const Judge &judge,
                LadderSums &sums) {
    Float8 lanes[29] = {};
    ladder_sums(stamp, shape, norm, state, judge, lanes);
    for (std::size_t k = 0; k < sums.size(); ++k)
        for (int i = 0; i < Stamp::lanes; ++i) sums[k] += lanes[k][i];
}

} // namespace fl::metrology
