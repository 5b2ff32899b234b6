// Hall channels and bridges of all lanes, in loops which the compiler turns into vectors: included by
// kernel_body.hpp, after lane_vectors.hpp.
namespace fl::twin {
namespace {

// The rest of an angle to the nearest quarter turn, and which it is. |angle| below 10^5 rad: pi/2 in two
// parts, the first with 33 bits, leaves an error below 1e-15 rad.
struct Quarters {
    float rest_rad[chunk_size];
    int32_t quarter[chunk_size];
};

inline void reduce(const AxisGroup &g, int chunk, Quarters &q) {
    // adding 1.5 * 2^52 shifts the fraction out: rounding that every instruction set can do
    constexpr double round_magic = 6755399441055744.0;
    for (int k = 0; k < chunk_size; ++k) {
        const double theta = g.theta_rad[chunk + k];
        const double turns = (theta * 0.63661977236758134308 + round_magic) - round_magic;
        const double rest = theta - turns * 1.57079632673412561417;
        q.rest_rad[k] = static_cast<float>(rest - turns * 6.07710050650619224932e-11);
        q.quarter[k] = static_cast<int32_t>(turns);
    }
}

// Minimax polynomials of Cephes (sinf.c): below 1e-7 on [-pi/4, pi/4].
inline void sincos(AxisGroup &g, int chunk, const Quarters &q) {
    for (int k = 0; k < chunk_size; ++k) {
        const float r = q.rest_rad[k], z = r * r;
        const float s = r + r * z * (-1.6666654611e-1f + z * (8.3321608736e-3f + z * -1.9515295891e-4f));
        const float c =
            1.0f - 0.5f * z +
            z * z * (4.166664568298827e-2f + z * (-1.388731625493765e-3f + z * 2.443315711809948e-5f));
        const bool odd = (q.quarter[k] & 1) != 0;
        const float s0 = odd ? c : s, c0 = odd ? s : c;
        g.sine[chunk + k] = (q.quarter[k] & 2) != 0 ? -s0 : s0;
        g.cosine[chunk + k] = ((q.quarter[k] + 1) & 2) != 0 ? -c0 : c0;
    }
}

// Good bits out of a counter (a 32-bit finaliser with two multiplications).
inline uint32_t scramble(uint32_t x) {
    x = (x ^ (x >> 16)) * 0x21f0aaadU;
    x = (x ^ (x >> 15)) * 0xd35a2d97U;
    return x ^ (x >> 15);
}

inline int32_t adc(float level) { return static_cast<int32_t>(held(level, 0.0f, 4095.0f) + 0.5f); }

// Noise: sums and differences of the four bytes of a word, so the channels are uncorrelated, and Gaussian
// enough for an ADC (it ends at 3.5 sigma).
inline void sense_hall(AxisGroup &g, int chunk, uint32_t tick) {
    constexpr float unit = 1.0f / 147.80054f; // rms of four bytes
    for (int i = chunk; i < chunk + chunk_size; ++i) {
        const uint32_t bits = scramble(g.noise_key[i] + tick * 0x9E3779B9U);
        const int32_t even = static_cast<int32_t>(bits & 255U) - static_cast<int32_t>(bits >> 16 & 255U);
        const int32_t odd = static_cast<int32_t>(bits >> 8 & 255U) - static_cast<int32_t>(bits >> 24);
        const float rms = g.hall_noise[i] * unit;
        const float a = g.hall_offset_a[i] + g.hall_sin_a[i] * g.sine[i];
        const float b = g.hall_offset_b[i] + (g.hall_cos_b[i] * g.cosine[i] + g.hall_sin_b[i] * g.sine[i]);
        g.hall_cnt[0][i] = adc(a + rms * static_cast<float>(even + odd));
        g.hall_cnt[1][i] = adc(b + rms * static_cast<float>(even - odd));
    }
}

constexpr uint64_t chunk_lanes = UINT64_MAX >> (64 - chunk_size); // a bit for each of its lanes

// Whether a chunk is to be left out: nothing moves in it, and no firmware looks at it or drives it.
inline bool left_out(const AxisGroup &g, int chunk, uint64_t used) {
    if ((used >> chunk & chunk_lanes) != 0) return false;
    int32_t every = -1;
    for (int i = chunk; i < chunk + chunk_size; ++i) every &= g.still[i];
    return every != 0;
}

void sense(AxisGroup &g, uint32_t tick, uint64_t used) {
    for (int chunk = 0; chunk < lane_count; chunk += chunk_size) {
        if (left_out(g, chunk, used)) continue;
        Quarters q;
        reduce(g, chunk, q);
        sincos(g, chunk, q);
        sense_hall(g, chunk, tick);
    }
}

// A bridge gives 0 to 1 of the supply, in whole steps of its PWM (below 2^22); here in steps.
inline float bridge(float duty, float steps) {
    constexpr float round_magic = 12582912.0f;
    return (held(duty, 0.0f, 1.0f) * steps + round_magic) - round_magic;
}

// Torque of three delta coils at standstill, Eq. 16 with 17: (lambda/R) sum u_k cos(theta + k 120 deg).
// An axis whose field changes is no longer still.
inline void drive_chunk(AxisGroup &g, int chunk) {
    for (int i = chunk; i < chunk + chunk_size; ++i) {
        const float a = bridge(g.duty[0][i], g.pwm_steps[i]), b = bridge(g.duty[1][i], g.pwm_steps[i]);
        const float c = bridge(g.duty[2][i], g.pwm_steps[i]);
        const float ab = b - a, bc = c - b, ca = a - c; // u_AB = u_B - u_A and cyclic
        const float along = g.drive_scale_Nms[i] * (ab - 0.5f * (bc + ca));
        const float across = g.drive_scale_Nms[i] * (0.8660254f * (ca - bc));
        const int32_t same = static_cast<int32_t>(along == g.drive_cos_Nms[i]) &
                             static_cast<int32_t>(across == g.drive_sin_Nms[i]);
        g.still[i] &= -same;
        g.drive_cos_Nms[i] = along;
        g.drive_sin_Nms[i] = across;
    }
}

void drive(AxisGroup &g, uint64_t used) {
    for (int chunk = 0; chunk < lane_count; chunk += chunk_size)
        if (!left_out(g, chunk, used)) drive_chunk(g, chunk);
}

} // namespace
} // namespace fl::twin
