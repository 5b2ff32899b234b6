// The inner loops, compiled once for every instruction set: included by kernel_*.cpp after these are set
//   FL_KERNEL_NAME   a string
//   FL_KERNEL_SYMBOL the Kernel to define
//   FL_KERNEL_WIDTH  doubles in a vector
// Nothing here may call an inline function of another header: the linker would keep one copy of it,
// perhaps the one that only runs on newer machines.
#include "fiberloom/twin/axis_group.hpp"
#include "law_body.hpp"

namespace fl::twin {
namespace {

constexpr int width = FL_KERNEL_WIDTH;
typedef double V __attribute__((vector_size(8 * width), may_alias));
typedef long long Mask __attribute__((vector_size(8 * width), may_alias));

inline V load(const double *p) { return *reinterpret_cast<const V *>(p); }
inline void store(double *p, V v) { *reinterpret_cast<V *>(p) = v; }
inline V larger(V a, V b) { return a > b ? a : b; }
inline V smaller(V a, V b) { return a < b ? a : b; }
inline V all(double x) { return V{} + x; }
inline V both(Mask m, V v) { return reinterpret_cast<V>(reinterpret_cast<Mask>(v) & m); }

inline bool any(Mask m) {
    long long bits = 0;
    for (int i = 0; i < width; ++i) bits |= m[i];
    return bits != 0;
}

// Nearest integer of |x| < 2^51: adding 1.5 * 2^52 shifts the fraction out. Every instruction set can.
constexpr double round_magic = 6755399441055744.0;
inline V nearest(V x) { return (x + round_magic) - round_magic; }

// sin and cos on [-pi/4, pi/4], fdlibm's minimax polynomials (k_sin.c, k_cos.c): below 1 ulp.
inline V sin_core(V r, V z) {
    const V u = z * (z * (z * (z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08) +
                          2.75573137070700676789e-06) -
                     1.98412698298579493134e-04) +
                8.33333333332248946124e-03;
    return r + r * z * (z * u - 1.66666666666666324348e-01);
}
inline V cos_core(V z) {
    const V u = z * (z * (z * (z * (z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09) -
                               2.75573143513906633035e-07) +
                          2.48015872894767294178e-05) -
                     1.38888888888741095749e-03) +
                4.16666666666666019037e-02;
    return 1.0 - (0.5 * z - z * z * u);
}

// |angle| below 10^5 rad: pi/2 in two parts, the first with 33 bits, leaves an error below 1e-15 rad.
inline void sincos(V angle, V &sine, V &cosine) {
    const V shifted = angle * 0.63661977236758134308 + round_magic;
    const V turns = shifted - round_magic;
    const Mask quadrant = reinterpret_cast<Mask>(shifted) & 3;
    const V r = (angle - turns * 1.57079632673412561417) - turns * 6.07710050650619224932e-11;
    const V z = r * r, s = sin_core(r, z), c = cos_core(z);
    const Mask odd = -(quadrant & 1);
    const V s0 = odd ? c : s, c0 = odd ? s : c;
    const Mask sign_s = (quadrant & 2) << 62, sign_c = ((quadrant + 1) & 2) << 62;
    sine = reinterpret_cast<V>(reinterpret_cast<Mask>(s0) ^ sign_s);
    cosine = reinterpret_cast<V>(reinterpret_cast<Mask>(c0) ^ sign_c);
}

// Turns (sine, cosine) by a small angle. The series are cut where, at 600 rad/s and 50 us, they err by
// 5e-8 a step: the torque feels it in the seventh digit, and each tick starts from exact values again.
inline void turn(V angle, V &sine, V &cosine) {
    const V z = angle * angle;
    const V s = angle - angle * (z * (1.0 / 6.0)), c = 1.0 - 0.5 * z;
    const V turned = sine * c + cosine * s;
    cosine = cosine * c - sine * s;
    sine = turned;
}

// Good bits out of a counter (a 32-bit finaliser with two multiplications).
inline uint32_t scramble(uint32_t x) {
    x = (x ^ (x >> 16)) * 0x21f0aaadU;
    x = (x ^ (x >> 15)) * 0xd35a2d97U;
    return x ^ (x >> 15);
}

// Two noises of unit variance from the four bytes of a word: sums and differences, so uncorrelated,
// and Gaussian enough for an ADC (they end at 3.5 sigma).
struct Noise {
    V a, b;
};

inline Noise noise(const AxisGroup &g, int i, uint32_t tick) {
    int32_t a[width], b[width];
    for (int k = 0; k < width; ++k) {
        const uint32_t bits = scramble(g.noise_key[i + k] + tick * 0x9E3779B9U);
        const int32_t even = static_cast<int32_t>(bits & 255U) - static_cast<int32_t>(bits >> 16 & 255U);
        const int32_t odd = static_cast<int32_t>(bits >> 8 & 255U) - static_cast<int32_t>(bits >> 24);
        a[k] = even + odd;
        b[k] = even - odd;
    }
    V va, vb;
    for (int k = 0; k < width; ++k) va[k] = a[k];
    for (int k = 0; k < width; ++k) vb[k] = b[k];
    constexpr double unit = 1.0 / 147.80054127099804; // rms of four bytes
    return {va * unit, vb * unit};
}

inline void convert(V level, int32_t *cnt) {
    const V held = smaller(larger(level, V{}), all(4095.0)) + 0.5;
    for (int k = 0; k < width; ++k) cnt[k] = static_cast<int32_t>(held[k]);
}

inline void sense_hall(AxisGroup &g, int i, uint32_t tick, V sine, V cosine) {
    const Noise n = noise(g, i, tick);
    const V rms = load(g.hall_noise + i);
    convert(load(g.hall_offset_a + i) + load(g.hall_sin_a + i) * sine + rms * n.a, g.hall_cnt[0] + i);
    convert(load(g.hall_offset_b + i) + load(g.hall_cos_b + i) * cosine + load(g.hall_sin_b + i) * sine +
                rms * n.b,
            g.hall_cnt[1] + i);
}

inline bool is_still(const AxisGroup &g, int lane) { return (g.still >> (lane / chunk_size) & 1U) != 0; }

void sense(AxisGroup &g, uint32_t tick) {
    for (int i = 0; i < lane_count; i += width) {
        V sine = load(g.sine + i), cosine = load(g.cosine + i); // exact already where nothing has moved
        if (!is_still(g, i)) sincos(load(g.theta_rad + i), sine, cosine);
        store(g.sine + i, sine);
        store(g.cosine + i, cosine);
        sense_hall(g, i, tick, sine, cosine);
    }
}

// A bridge gives 0 to 1 of the supply, in whole steps of its PWM; here in steps.
inline V bridge(const float *duty, V steps) {
    V d;
    for (int k = 0; k < width; ++k) d[k] = static_cast<double>(duty[k]);
    return nearest(smaller(larger(d, V{}), all(1.0)) * steps);
}

// Torque of three delta coils at standstill, Eq. 16 with 17: (lambda/R) sum u_k cos(theta + k 120 deg).
void drive(AxisGroup &g) {
    for (int i = 0; i < lane_count; i += width) {
        const V steps = load(g.pwm_steps + i), scale = load(g.drive_scale_Nms + i);
        const V a = bridge(g.duty[0] + i, steps), b = bridge(g.duty[1] + i, steps),
                c = bridge(g.duty[2] + i, steps);
        const V ab = b - a, bc = c - b, ca = a - c; // u_AB = u_B - u_A and cyclic
        const V along = scale * (ab - 0.5 * (bc + ca)), across = scale * (0.86602540378443864676 * (ca - bc));
        const Mask changed = (along != load(g.drive_cos_Nms + i)) | (across != load(g.drive_sin_Nms + i));
        if (any(changed)) g.still &= ~(1U << (i / chunk_size));
        store(g.drive_cos_Nms + i, along);
        store(g.drive_sin_Nms + i, across);
    }
}

// What changes inside a tick, in registers.
struct Motion {
    V theta, p, gear, sine, cosine;
};

inline Motion load_motion(const AxisGroup &g, int i) {
    return {load(g.theta_rad + i), load(g.p_Nms + i), load(g.gear_rad + i), load(g.sine + i),
            load(g.cosine + i)};
}

inline void store_motion(AxisGroup &g, int i, const Motion &m) {
    store(g.theta_rad + i, m.theta);
    store(g.p_Nms + i, m.p);
    store(g.gear_rad + i, m.gear);
    store(g.sine + i, m.sine);
    store(g.cosine + i, m.cosine);
}

inline void drift(Motion &m, V by) {
    m.theta += by;
    turn(by, m.sine, m.cosine);
}

// Magnet and coils, and cogging of two and four cycles: cos 2t = 1 - 2 sin^2 t, cos 4t = 1 - 2 sin^2 2t.
inline V torque_impulse(const AxisGroup &g, int i, V s, V c) {
    const V twice = s + s, s2 = twice * c, c2 = 1.0 - twice * s;
    const V even = load(g.cog_2c_Nms + i) * c2 + load(g.cog_4c_Nms + i);
    const V odd = load(g.cog_2s_Nms + i) + (load(g.cog_4s_Nms + i) * c2 - load(g.cog_4c_Nms + i) * (s2 + s2));
    return load(g.drive_sin_Nms + i) * s + load(g.drive_cos_Nms + i) * c - even - odd * s2;
}

struct Contact {
    Mask positive, negative;
};

// The gear gives way to whoever closes the gap, and stays where it is otherwise: it cannot be driven
// back. In contact both sides are the same number, not nearly so.
inline Contact close_gap(const AxisGroup &g, int i, V theta, V &gear) {
    const V from_below = (theta - load(g.backlash_0_rad + i)) * load(g.backlash_scale + i);
    gear = smaller(larger(gear, from_below), theta);
    return {from_below >= gear, theta <= gear};
}

inline V step_per_p(const AxisGroup &g, int i, Mask pushing) {
    return pushing ? load(g.step_per_p_push + i) : load(g.step_per_p_free + i);
}

// A rotor that slides towards the angle where friction holds it would take for ever. What friction leaves
// of a momentum is taken as nothing below this share of an impulse of the rotor's own friction: 1e-7 rad/s.
constexpr double stick_share = 1e-5;

// One kick at the middle of a step: contact, set-valued friction, trapezoidal drag. Returns the drift
// of a whole step with the new momentum. Eq. 3, 4 and 8; docs/twin.md.
inline V kick(const AxisGroup &g, int i, Motion &m) {
    const Contact contact = close_gap(g, i, m.theta, m.gear);
    const V motor = load(g.coulomb_motor_Nms + i);
    const V up = motor + both(contact.positive, load(g.resist_up_Nms + i));
    const V down = motor + both(contact.negative, load(g.resist_down_Nms + i));

    const V free = m.p + torque_impulse(g, i, m.sine, m.cosine);
    const Mask pushing = (contact.positive & (free > V{})) | (contact.negative & (free < V{}));
    const V slowed = free - (pushing ? load(g.drag_push + i) : load(g.drag_free + i)) * m.p;
    const V rise = slowed - up, fall = slowed + down, least = motor * stick_share;
    const V moved = both(rise > least, rise) + both(fall < -least, fall);
    m.p = moved * (pushing ? load(g.drag_push_inverse + i) : load(g.drag_free_inverse + i));
    return m.p * step_per_p(g, i, pushing);
}

// The half drift at the start of a tick needs the mode in which the last one ended.
inline V drift_now(const AxisGroup &g, int i, const Motion &m) {
    V gear = m.gear;
    const Contact contact = close_gap(g, i, m.theta, gear);
    return m.p * step_per_p(g, i, (contact.positive & (m.p > V{})) | (contact.negative & (m.p < V{})));
}

// Spring, outside torque and hard stops change by less than 1e-9 of the friction inside a tick. The gear
// takes from the rotor its friction and this load, and never gives: not below zero.
inline void load_gear(AxisGroup &g, int i) {
    const V gear = load(g.gear_rad + i);
    const V over = larger(gear - load(g.stop_hi_rad + i), V{}) + smaller(gear - load(g.stop_lo_rad + i), V{});
    const V push = load(g.load_0_Nms + i) + load(g.load_1_Nms + i) * gear - load(g.stop_Nms + i) * over;
    const V friction = load(g.coulomb_gear_Nms + i);
    store(g.resist_up_Nms + i, larger(friction - push, V{}));
    store(g.resist_down_Nms + i, larger(friction + push, V{}));
}

inline void begin_tick(AxisGroup &g, int i) {
    load_gear(g, i);
    Motion m = load_motion(g, i);
    store(g.theta_before_rad + i, m.theta);
    drift(m, 0.5 * drift_now(g, i, m));
    store_motion(g, i, m);
}

inline void substep(AxisGroup &g, int i, double share) {
    Motion m = load_motion(g, i);
    drift(m, share * kick(g, i, m));
    store_motion(g, i, m);
}

inline Mask end_tick(AxisGroup &g, int i) {
    V gear = load(g.gear_rad + i);
    close_gap(g, i, load(g.theta_rad + i), gear);
    store(g.gear_rad + i, gear);
    return (gear < load(g.cell_lo_rad + i)) | (gear >= load(g.cell_hi_rad + i));
}

// At rest now, and where it was: then it was at rest all the time, for the field stands in a tick.
inline Mask has_moved(const AxisGroup &g, int i) {
    return (load(g.theta_rad + i) != load(g.theta_before_rad + i)) | (load(g.p_Nms + i) != V{});
}

uint32_t lanes_out_of_cell(const AxisGroup &g) {
    uint32_t out = 0;
    for (int i = 0; i < lane_count; ++i)
        if (g.gear_rad[i] < g.cell_lo_rad[i] || g.gear_rad[i] >= g.cell_hi_rad[i]) out |= 1U << i;
    return out;
}

inline void begin_chunk(AxisGroup &g, int chunk) {
    for (int i = chunk; i < chunk + chunk_size; i += width) begin_tick(g, i);
}

inline void substep_chunk(AxisGroup &g, int chunk, double share) {
    for (int i = chunk; i < chunk + chunk_size; i += width) substep(g, i, share);
}

// Half drift, kick, half drift; two half drifts between kicks are one. Chunks in turn inside a substep,
// so that the processor always has several independent ones to work on.
TickEvents step(AxisGroup &g, int substeps) {
    int chunks[lane_count / chunk_size], count = 0;
    for (int c = 0; c < lane_count; c += chunk_size)
        if (!is_still(g, c)) chunks[count++] = c;
    if (count == 0) return {};
    for (int k = 0; k < count; ++k) begin_chunk(g, chunks[k]);
    for (int n = 1; n < substeps; ++n)
        for (int k = 0; k < count; ++k) substep_chunk(g, chunks[k], 1.0);
    for (int k = 0; k < count; ++k) substep_chunk(g, chunks[k], 0.5);
    Mask left{};
    for (int k = 0; k < count; ++k) {
        Mask moved{};
        for (int i = chunks[k]; i < chunks[k] + chunk_size; i += width) {
            left |= end_tick(g, i);
            moved |= has_moved(g, i);
        }
        if (!any(moved)) g.still |= 1U << (chunks[k] / chunk_size);
    }
    return {any(left) ? lanes_out_of_cell(g) : 0};
}

} // namespace

extern const Kernel FL_KERNEL_SYMBOL;
const Kernel FL_KERNEL_SYMBOL = {FL_KERNEL_NAME, sense, drive, step, hall_law, drive_law};

} // namespace fl::twin
