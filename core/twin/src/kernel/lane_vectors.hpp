// Vectors of lanes in single and double precision; included by kernel_body.hpp, compiled for every
// instruction set. Intrinsics stand where a compiler makes something longer of what they say.
#if FL_KERNEL_WIDTH > 4
#include <immintrin.h>
#endif

#include "fiberloom/twin/axis_group.hpp"

namespace fl::twin {
namespace {

constexpr int width = FL_KERNEL_WIDTH;
typedef float V __attribute__((vector_size(4 * width), may_alias));
typedef int32_t Mask __attribute__((vector_size(4 * width), may_alias));

// A compiler that leaves a call or a loop inside a substep keeps in memory what moves.
#define FL_INLINED __attribute__((always_inline))

inline V load(const float *p) { return *reinterpret_cast<const V *>(p); }
inline void store(float *p, V v) { *reinterpret_cast<V *>(p) = v; }
inline V larger(V a, V b) { return a > b ? a : b; }
inline V smaller(V a, V b) { return a < b ? a : b; }
inline V both(Mask m, V v) { return reinterpret_cast<V>(reinterpret_cast<Mask>(v) & m); }

inline float held(float x, float lo, float hi) { return x > lo ? (x < hi ? x : hi) : lo; }

typedef double Exact __attribute__((vector_size(4 * width), may_alias));
typedef int64_t ExactMask __attribute__((vector_size(4 * width), may_alias));
constexpr int exact_width = width / 2;

inline Exact load(const double *p) { return *reinterpret_cast<const Exact *>(p); }
inline void store(double *p, Exact v) { *reinterpret_cast<Exact *>(p) = v; }
inline Exact larger(Exact a, Exact b) { return a > b ? a : b; }
inline Exact smaller(Exact a, Exact b) { return a < b ? a : b; }

// What of a vector belongs to its lanes from `from` on in double, and such parts joined to one again.
#if FL_KERNEL_WIDTH == 16
template <int from> FL_INLINED inline Exact exact(V v) {
    return reinterpret_cast<Exact>(_mm512_maskz_cvtps_pd(
        0xff, _mm512_maskz_extractf32x8_ps(0xff, reinterpret_cast<__m512>(v), from / 8)));
}
FL_INLINED inline V rounded(Exact lower, Exact upper) {
    const __m512 lo = _mm512_castps256_ps512(_mm512_maskz_cvtpd_ps(0xff, reinterpret_cast<__m512d>(lower)));
    return reinterpret_cast<V>(_mm512_maskz_insertf32x8(
        0xffff, lo, _mm512_maskz_cvtpd_ps(0xff, reinterpret_cast<__m512d>(upper)), 1));
}
// a where the flag is set, else b.
template <int from> FL_INLINED inline Exact either(Mask flags, Exact a, Exact b) {
    const auto bits = static_cast<__mmask8>(_mm512_movepi32_mask(reinterpret_cast<__m512i>(flags)) >> from);
    return reinterpret_cast<Exact>(
        _mm512_mask_blend_pd(bits, reinterpret_cast<__m512d>(b), reinterpret_cast<__m512d>(a)));
}
#elif FL_KERNEL_WIDTH == 8
template <int from> FL_INLINED inline Exact exact(V v) {
    return reinterpret_cast<Exact>(
        _mm256_cvtps_pd(_mm256_extractf128_ps(reinterpret_cast<__m256>(v), from / 4)));
}
FL_INLINED inline V rounded(Exact lower, Exact upper) {
    return reinterpret_cast<V>(_mm256_set_m128(_mm256_cvtpd_ps(reinterpret_cast<__m256d>(upper)),
                                               _mm256_cvtpd_ps(reinterpret_cast<__m256d>(lower))));
}
template <int from> FL_INLINED inline Exact either(Mask flags, Exact a, Exact b) {
    const __m128i part = _mm256_extracti128_si256(reinterpret_cast<__m256i>(flags), from / 4);
    return reinterpret_cast<ExactMask>(_mm256_cvtepi32_epi64(part)) ? a : b;
}
#else
template <int from> FL_INLINED inline Exact exact(V v) {
    Exact part;
    for (int k = 0; k < exact_width; ++k) part[k] = static_cast<double>(v[from + k]);
    return part;
}
FL_INLINED inline V rounded(Exact lower, Exact upper) {
    V both;
    for (int k = 0; k < exact_width; ++k) {
        both[k] = static_cast<float>(lower[k]);
        both[exact_width + k] = static_cast<float>(upper[k]);
    }
    return both;
}
template <int from> FL_INLINED inline Exact either(Mask flags, Exact a, Exact b) {
    Mask twice;
    for (int k = 0; k < width; ++k) twice[k] = flags[from + k / 2];
    return reinterpret_cast<ExactMask>(twice) ? a : b;
}
#endif

// A bit for each flag that is set.
inline uint64_t bits_of(ExactMask flags) {
#if FL_KERNEL_WIDTH == 16
    return _mm512_movepi64_mask(reinterpret_cast<__m512i>(flags));
#elif FL_KERNEL_WIDTH == 8
    return static_cast<uint64_t>(_mm256_movemask_pd(reinterpret_cast<__m256d>(flags)));
#else
    uint64_t bits = 0;
    for (int k = 0; k < exact_width; ++k) bits |= static_cast<uint64_t>(flags[k] & 1) << k;
    return bits;
#endif
}

} // namespace
} // namespace fl::twin
