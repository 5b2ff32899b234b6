// The inner loops, compiled once for every instruction set: included by kernel_*.cpp after these are set
//   FL_KERNEL_NAME   a string
//   FL_KERNEL_SYMBOL the Kernel to define
//   FL_KERNEL_WIDTH  floats in a vector
// Nothing here may call an inline function of another header: the linker would keep one copy of it,
// perhaps the one that only runs on newer machines; intrinsics leave none.
#include "fiberloom/twin/axis_group.hpp"
#include "lane_vectors.hpp"
// after those that they use
#include "law_body.hpp"
#include "signal_body.hpp"

namespace fl::twin {
namespace {

// -- from angles to ways, and back -----------------------------------------------------------------

// A group inside a tick: ways since theta at its start, and the load as it was there. Of lanes in which
// nothing moves they are not set.
struct alignas(64) Tick {
    explicit Tick(AxisGroup &group) : g(group) {}
    AxisGroup::Lanes turned_rad;                     // of the rotor
    AxisGroup::Lanes gear_ahead_rad, gear_start_rad; // gear, now and at the start
    AxisGroup::Lanes closed_rad;                     // gear angle of positive contact at the start
    AxisGroup::Lanes closed_scale;                   // and its change with the rotor
    AxisGroup::Lanes resist_up_Nms, resist_down_Nms; // what the gear takes from the rotor that moves it
    AxisGroup &g;                                    // last, so that lanes stay aligned
};

// Spring, outside torque and hard stops, towards larger angles. `stops`: a gear may be at one.
template <bool stops> FL_INLINED inline Exact push_on_gear(const AxisGroup &g, int i, Exact gear) {
    const Exact push = load(g.load_0_Nms + i) + load(g.load_1_Nms + i) * gear;
    if (!stops) return push;
    const Exact none{},
        over = larger(gear - load(g.stop_hi_rad + i), none) + smaller(gear - load(g.stop_lo_rad + i), none);
    return push - load(g.stop_Nms + i) * over;
}

// From angles to ways since the start of the tick. What pushes the gear changes by less than 1e-9 of the
// friction inside it. The gear takes from the rotor its friction and this load, and never gives: not below
// zero.
template <bool stops> FL_INLINED inline void begin_ways(Tick &t, int i) {
    const AxisGroup &g = t.g;
    const V coulomb = load(g.coulomb_gear_Nms + i);
    Exact ahead[2], shut[2], scale[2], up[2], down[2];
    const auto half = [&](int k, int at, Exact friction) FL_INLINED {
        const Exact gear = load(g.gear_rad + at), theta = load(g.theta_rad + at), none{};
        const Exact push = push_on_gear<stops>(g, at, gear);
        up[k] = larger(friction - push, none);
        down[k] = larger(friction + push, none);
        scale[k] = load(g.backlash_scale + at);
        shut[k] = (theta - load(g.backlash_0_rad + at)) * scale[k] - theta;
        ahead[k] = gear - theta;
    };
    half(0, i, exact<0>(coulomb));
    half(1, i + exact_width, exact<exact_width>(coulomb));
    store(t.resist_up_Nms + i, rounded(up[0], up[1]));
    store(t.resist_down_Nms + i, rounded(down[0], down[1]));
    store(t.closed_scale + i, rounded(scale[0], scale[1]));
    store(t.closed_rad + i, rounded(shut[0], shut[1]));
    store(t.gear_start_rad + i, rounded(ahead[0], ahead[1]));
}

inline void begin_ways_of_chunk(Tick &t, int chunk) {
    const bool stops = (t.g.near_stop >> chunk & chunk_lanes) != 0;
    for (int i = chunk; i < chunk + chunk_size; i += width)
        stops ? begin_ways<true>(t, i) : begin_ways<false>(t, i);
}

// And back. In contact the gear is where the rotor puts it, to the last bit of a double: rounded ways would
// open the contact again. An axis at rest now, and where it was, has rested all the time, for the field does
// not turn in a tick: it is still. Tells which gears have left their cells, and which are about to.
FL_INLINED inline void end_ways(Tick &t, int i, V turned, V gear_ahead, TickEvents &events) {
    AxisGroup &g = t.g;
    const V from_below = load(t.closed_rad + i) + turned * load(t.closed_scale + i);
    const V gear = smaller(larger(gear_ahead, from_below), turned);
    const Mask shut = from_below >= gear, open = turned <= gear, kept = gear == load(t.gear_start_rad + i);
    const auto half = [&](int at, Exact way, Exact gear_way, auto &&choose) FL_INLINED {
        const Exact start = load(g.theta_rad + at), theta = start + way;
        const Exact closed = (theta - load(g.backlash_0_rad + at)) * load(g.backlash_scale + at);
        const Exact now = choose(closed, theta, load(g.gear_rad + at), start + gear_way);
        const Exact lo = load(g.cell_lo_rad + at), hi = load(g.cell_hi_rad + at), later = now + (way + way);
        const ExactMask out = (now < lo) | (now >= hi);
        events.left_cell |= bits_of(out) << at;
        events.will_leave |= bits_of(out | (later < lo) | (later >= hi)) << at;
        store(g.gear_rad + at, now);
        store(g.theta_rad + at, theta);
    };
    half(i, exact<0>(turned), exact<0>(gear),
         [&](Exact closed, Exact theta, Exact before, Exact alone) FL_INLINED {
             return either<0>(shut, closed, either<0>(open, theta, either<0>(kept, before, alone)));
         });
    half(i + exact_width, exact<exact_width>(turned), exact<exact_width>(gear),
         [&](Exact closed, Exact theta, Exact before, Exact alone) FL_INLINED {
             return either<exact_width>(
                 shut, closed, either<exact_width>(open, theta, either<exact_width>(kept, before, alone)));
         });
    *reinterpret_cast<Mask *>(g.still + i) = (turned == V{}) & (load(g.p_Nms + i) == V{});
}

inline void end_ways_of_chunk(Tick &t, int chunk, TickEvents &events) {
    for (int i = chunk; i < chunk + chunk_size; i += width)
        end_ways(t, i, load(t.turned_rad + i), load(t.gear_ahead_rad + i), events);
}

// -- inside a tick, in registers -----------------------------------------------------------------

constexpr int chunk_vectors = chunk_size / width;
static_assert(width < 16 || chunk_vectors == 1); // a chunk is a vector there

// what(n, lane) for each vector n of some chunks, or of other parts of so many vectors, and its first lane:
// without a loop where all fits into the registers of the machine.
template <int count, int vectors = chunk_vectors, class What>
FL_INLINED inline void in_turn(const int *parts, What &&what) {
    if constexpr (width < 16) {
        for (int k = 0; k < count; ++k)
            for (int v = 0; v < vectors; ++v) what(k * vectors + v, parts[k] + v * width);
    } else {
        if constexpr (count > 1) in_turn<count - 1>(parts, what);
        what(count - 1, parts[count - 1]);
    }
}

struct Motion {
    V turned, p, gear, sine, cosine;
};

FL_INLINED inline Motion load_motion(const Tick &t, int i) {
    return {load(t.turned_rad + i), load(t.g.p_Nms + i), load(t.gear_ahead_rad + i), load(t.g.sine + i),
            load(t.g.cosine + i)};
}

FL_INLINED inline void store_motion(Tick &t, int i, const Motion &m) {
    store(t.turned_rad + i, m.turned);
    store(t.g.p_Nms + i, m.p);
    store(t.gear_ahead_rad + i, m.gear);
    store(t.g.sine + i, m.sine);
    store(t.g.cosine + i, m.cosine);
}

// The series are cut where, at 600 rad/s and 50 us, they err by 5e-8 a step: the torque feels it in the
// seventh digit, and each tick starts from exact values again.
template <class M> FL_INLINED inline void drift(M &m, V by) {
    const V z = by * by;
    const V s = by - by * (z * (1.0f / 6.0f)), c = 1.0f - 0.5f * z;
    const V turned = m.sine * c + m.cosine * s;
    m.cosine = m.cosine * c - m.sine * s;
    m.sine = turned;
    m.turned += by;
}

// Magnet and coils, and cogging of two and four cycles: cos 2t = 1 - 2 sin^2 t, cos 4t = 1 - 2 sin^2 2t.
FL_INLINED inline V torque_impulse(const Tick &t, int i, V s, V c) {
    const V twice = s + s, s2 = twice * c, c2 = 1.0f - twice * s;
    const V even = load(t.g.cog_2c_Nms + i) * c2 + load(t.g.cog_4c_Nms + i);
    const V odd =
        load(t.g.cog_2s_Nms + i) + (load(t.g.cog_4s_Nms + i) * c2 - load(t.g.cog_4c_Nms + i) * (s2 + s2));
    return load(t.g.drive_sin_Nms + i) * s + load(t.g.drive_cos_Nms + i) * c - even - odd * s2;
}

struct Contact {
    Mask positive, negative;
};

// The gear gives way to the side that closes the gap, and stays where it is otherwise: it cannot be driven
// back. In contact both sides are the same number, not nearly so.
FL_INLINED inline Contact close_gap(const Tick &t, int i, V turned, V &gear) {
    const V from_below = load(t.closed_rad + i) + turned * load(t.closed_scale + i);
    gear = smaller(larger(gear, from_below), turned);
    return {from_below >= gear, turned <= gear};
}

FL_INLINED inline V step_per_p(const Tick &t, int i, Mask pushing) {
    return pushing ? load(t.g.step_per_p_push + i) : load(t.g.step_per_p_free + i);
}

// A rotor that slides towards the angle where friction holds it would take for ever. What friction leaves
// of a momentum is taken as nothing below this share of an impulse of the rotor's own friction: 1e-7 rad/s.
constexpr float stick_share = 1e-5f;

// What friction takes from a rotor, and from the gear where it moves that, towards larger and smaller angles.
struct Resist {
    V up, down, least; // least: of what is left
};
FL_INLINED inline Resist resist(const Tick &t, int i, const Contact &contact) {
    const V motor = load(t.g.coulomb_motor_Nms + i);
    return {motor + both(contact.positive, load(t.resist_up_Nms + i)),
            motor + both(contact.negative, load(t.resist_down_Nms + i)), motor * stick_share};
}

// Lanes at rest that friction holds. The field does not turn in a tick: a kick that leaves them where they
// are is like the next one, and they are still throughout.
FL_INLINED inline Mask held_by_friction(const Tick &t, int i) {
    V gear = load(t.gear_start_rad + i);
    const Resist r = resist(t, i, close_gap(t, i, V{}, gear));
    const V free = torque_impulse(t, i, load(t.g.sine + i), load(t.g.cosine + i));
    return (load(t.g.p_Nms + i) == V{}) & ~((free - r.up > r.least) | (free + r.down < -r.least));
}

// One kick at the middle of a step: contact, set-valued friction, trapezoidal drag. Returns the drift
// of a whole step with the new momentum. Eq. 3, 4 and 8; docs/twin.md.
FL_INLINED inline V kick(const Tick &t, int i, Motion &m) {
    const Contact contact = close_gap(t, i, m.turned, m.gear);
    const Resist r = resist(t, i, contact);
    const V free = m.p + torque_impulse(t, i, m.sine, m.cosine);
    const Mask pushing = (contact.positive & (free > V{})) | (contact.negative & (free < V{}));
    const V slowed = free - (pushing ? load(t.g.drag_push + i) : load(t.g.drag_free + i)) * m.p;
    const V rise = slowed - r.up, fall = slowed + r.down;
    const V moved = both(rise > r.least, rise) + both(fall < -r.least, fall);
    m.p = moved * (pushing ? load(t.g.drag_push_inverse + i) : load(t.g.drag_free_inverse + i));
    return m.p * step_per_p(t, i, pushing);
}

// The half drift at the start of a tick needs the mode in which the last one ended.
FL_INLINED inline V drift_now(const Tick &t, int i, const Motion &m) {
    V gear = m.gear;
    const Contact contact = close_gap(t, i, m.turned, gear);
    return m.p * step_per_p(t, i, (contact.positive & (m.p > V{})) | (contact.negative & (m.p < V{})));
}

// Lanes of a group that have done their tick, all bits of each.
struct Done {
    alignas(64) int32_t lane[lane_count];
};

FL_INLINED inline void store_rest(Tick &t, int i, const Done &done, Motion m) {
    const Mask had = *reinterpret_cast<const Mask *>(done.lane + i);
    const Motion before = load_motion(t, i);
    m.turned = had ? before.turned : m.turned;
    m.p = had ? before.p : m.p;
    m.gear = had ? before.gear : m.gear;
    store_motion(t, i, m);
}

// Half drift, kick, half drift; two half drifts between kicks are one. Vectors, by their first lanes, stay in
// registers over the substeps, and take turns inside each, so that the processor has independent ones to work
// on.
template <int count> inline void move(Tick &t, const int *vectors, int substeps, const Done &done) {
    Motion motion[count];
    const auto each = [&](auto &&what) FL_INLINED {
        in_turn<count, 1>(vectors, [&](int n, int i) FL_INLINED { what(motion[n], i); });
    };
    each([&](Motion &m, int i) FL_INLINED {
        m = load_motion(t, i);
        drift(m, 0.5f * drift_now(t, i, m));
    });
    for (int n = 1; n < substeps; ++n) each([&](Motion &m, int i) FL_INLINED { drift(m, kick(t, i, m)); });
    each([&](Motion &m, int i) FL_INLINED {
        drift(m, 0.5f * kick(t, i, m));
        store_rest(t, i, done, m);
    });
}

// -- the same while the rotor pushes its gear -----------------------------------------------------

// Contact lasts until the rotor turns back, so that no kick has to ask for it.
struct Pushing {
    V turned, p, sine, cosine;
    V resist;  // what rotor and gear take, signed as the motion is
    V slowest; // what friction has left of the momentum at least, in the direction of the motion
    Mask down; // the sign bit where that is to smaller angles
};

FL_INLINED inline Mask still(const Tick &t, int i) { return *reinterpret_cast<const Mask *>(t.g.still + i); }
FL_INLINED inline Mask moved_or_still(const Tick &t, int i, const Done &done) {
    return *reinterpret_cast<const Mask *>(done.lane + i) | still(t, i);
}
FL_INLINED inline V turned_by(V v, Mask sign) {
    return reinterpret_cast<V>(reinterpret_cast<Mask>(v) ^ sign);
}

// Lanes that set out pushing, or are still.
FL_INLINED inline Mask sets_out_pushing(const Tick &t, int i) {
    const V p = load(t.g.p_Nms + i);
    V gear = load(t.gear_start_rad + i);
    const Contact contact = close_gap(t, i, V{}, gear);
    return (contact.positive & (p > V{})) | (contact.negative & (p < V{})) | still(t, i);
}

// A step of all of a tick as a share of the longer ones, and its inverse.
inline float per_step(Substeps s) { return static_cast<float>(s.pushing) / static_cast<float>(s.all); }
inline float steps(Substeps s) { return static_cast<float>(s.all) / static_cast<float>(s.pushing); }

// What a step of a rotor that pushes needs beside impulses. `coarse`: of the longer steps; the momentum is
// then told in steps, too, by the share `per_step` of its own, so that every impulse stays as it is.
template <bool coarse> FL_INLINED inline V drag_of(const Tick &t, int i) {
    return load((coarse ? t.g.drag_coarse : t.g.drag_push) + i);
}
template <bool coarse> FL_INLINED inline V drag_inverse_of(const Tick &t, int i) {
    return load((coarse ? t.g.drag_coarse_inverse : t.g.drag_push_inverse) + i);
}
template <bool coarse> FL_INLINED inline V way_per_p(const Tick &t, int i) {
    return load((coarse ? t.g.step_per_p_coarse : t.g.step_per_p_push) + i);
}

FL_INLINED inline Pushing load_pushing(const Tick &t, int i, float per_step) {
    const V p = load(t.g.p_Nms + i) * per_step, motor = load(t.g.coulomb_motor_Nms + i);
    const V up = motor + load(t.resist_up_Nms + i), down = motor + load(t.resist_down_Nms + i);
    const Mask falls = p < V{};
    return {V{}, p, load(t.g.sine + i), load(t.g.cosine + i), falls ? -down : up, up + down, falls << 31};
}

// kick() where the rotor pushes.
template <bool coarse> FL_INLINED inline V push(const Tick &t, int i, Pushing &m) {
    const V free = m.p + torque_impulse(t, i, m.sine, m.cosine);
    const V moved = free - drag_of<coarse>(t, i) * m.p - m.resist;
    m.slowest = smaller(m.slowest, turned_by(moved, m.down));
    m.p = moved * drag_inverse_of<coarse>(t, i);
    return m.p * way_per_p<coarse>(t, i);
}

// Lanes that have pushed all the time, or are still.
FL_INLINED inline Mask kept_pushing(const Tick &t, int i, const Pushing &m) {
    return (m.slowest > load(t.g.coulomb_motor_Nms + i) * stick_share) | still(t, i);
}

// The end of the tick of a vector that has. turned: at the last kick, which sets the gear; steps: of the
// longer ones in a tick, over those of all.
template <bool coarse>
FL_INLINED inline void end_pushing(Tick &t, int i, const Pushing &m, V turned, float steps,
                                   TickEvents &events) {
    const Mask moves = ~still(t, i);
    V gear = load(t.gear_start_rad + i);
    close_gap(t, i, both(moves, turned), gear);
    store(t.g.p_Nms + i, both(moves, coarse ? m.p * steps : m.p));
    end_ways(t, i, both(moves, m.turned), gear, events);
}

// Some of the lanes of a vector; the others stay as they are.
FL_INLINED inline void store_lanes(Tick &t, int i, Mask lanes, const Pushing &m, V turned, float steps) {
    const V before = load(t.gear_ahead_rad + i);
    V gear = before;
    close_gap(t, i, turned, gear);
    store(t.gear_ahead_rad + i, lanes ? gear : before);
    store(t.turned_rad + i, lanes ? m.turned : load(t.turned_rad + i));
    store(t.g.p_Nms + i, lanes ? m.p * steps : load(t.g.p_Nms + i));
}

FL_INLINED inline bool all(Mask flags) {
#if FL_KERNEL_WIDTH == 16
    return _mm512_movepi32_mask(reinterpret_cast<__m512i>(flags)) == 0xffff;
#elif FL_KERNEL_WIDTH == 8
    return _mm256_movemask_ps(reinterpret_cast<__m256>(flags)) == 0xff;
#else
    int32_t every = -1;
    for (int k = 0; k < width; ++k) every &= flags[k];
    return every != 0;
#endif
}

// Whether a flag is set in all lanes of a chunk.
template <class Flags> FL_INLINED inline bool all_of_chunk(int chunk, Flags &&flags_of) {
    Mask every = flags_of(chunk, 0);
    for (int v = 1; v < chunk_vectors; ++v) every &= flags_of(chunk + v * width, v);
    return all(every);
}

// Some parts of a group, by their first lanes.
template <int size> struct Parts {
    int at[lane_count / size];
    int count = 0;
    void add(int first) { at[count++] = first; }
};
using Chunks = Parts<chunk_size>;
using Vectors = Parts<width>;

// The motion of some chunks that push, vector by vector: at the end of a tick, and as it was at the last
// kick.
template <int count> struct Push {
    Pushing motion[count * chunk_vectors];
    V turned[count * chunk_vectors];
};

template <int count, bool coarse>
FL_INLINED inline void push_through(const Tick &t, const int *chunks, int substeps, float per_step,
                                    Push<count> &p) {
    const auto each = [&](auto &&what) FL_INLINED {
        in_turn<count>(chunks, [&](int n, int i) FL_INLINED { what(p.motion[n], i, p.turned[n]); });
    };
    each([&](Pushing &m, int i, V &) FL_INLINED {
        m = load_pushing(t, i, per_step);
        drift(m, 0.5f * (m.p * way_per_p<coarse>(t, i)));
    });
    for (int n = 1; n < substeps; ++n)
        each([&](Pushing &m, int i, V &) FL_INLINED { drift(m, push<coarse>(t, i, m)); });
    each([&](Pushing &m, int i, V &at_kick) FL_INLINED {
        at_kick = m.turned;
        drift(m, 0.5f * push<coarse>(t, i, m));
    });
}

// As move(), to the bit, where all lanes push in the same steps. Chunks in which a rotor has come to rest or
// turned back stay as they were: `others` gets them.
template <int count, bool coarse>
inline void glide(Tick &t, const int *chunks, Substeps substeps, Chunks &others, TickEvents &events) {
    Push<count> p;
    push_through<count, coarse>(t, chunks, substeps.pushing, coarse ? per_step(substeps) : 1.0f, p);
    Mask kept[count * chunk_vectors];
    in_turn<count>(chunks, [&](int n, int i) FL_INLINED { kept[n] = kept_pushing(t, i, p.motion[n]); });
    in_turn<count>(chunks, [&](int n, int i) FL_INLINED {
        const int first = n - n % chunk_vectors; // of the chunk
        Mask every = kept[first];
        for (int v = 1; v < chunk_vectors; ++v) every &= kept[first + v];
        if (all(every))
            end_pushing<coarse>(t, i, p.motion[n], p.turned[n], steps(substeps), events);
        else if (n == first)
            others.add(i);
    });
}

// -- longer steps --------------------------------------------------------------------------------

// What makes an error is the moment of a contact, not a smooth motion: an axis that pushes its gear through
// the whole tick takes fewer steps. Any other takes all of them, beside it: what an axis does is its own.
// `done` says which lanes of the chunk have been moved here.
inline void move_coarsely(Tick &t, int chunk, Substeps substeps, Done &done) {
    Push<1> p;
    push_through<1, true>(t, &chunk, substeps.pushing, per_step(substeps), p);
    for (int v = 0; v < chunk_vectors; ++v) {
        const int i = chunk + v * width;
        const Mask lanes = sets_out_pushing(t, i) & kept_pushing(t, i, p.motion[v]) & ~still(t, i);
        *reinterpret_cast<Mask *>(done.lane + i) = lanes;
        store_lanes(t, i, lanes, p.motion[v], p.turned[v], steps(substeps));
    }
}

// -- seats --------------------------------------------------------------------------------------

// A sum of twelve times three bytes of a scrambled counter.
void bells(const uint64_t *__restrict counter, double *__restrict bell, int count) {
    constexpr int together = width > 4 ? bell_vector : 1; // the baseline has no product of 64 bits
    for (int first = 0; first < count; first += together)
        for (int i = first; i < first + together; ++i) {
            uint64_t z = counter[i] * 0x9E3779B97F4A7C15ULL, sum = 0;
            for (int k = 0; k < 12; ++k) {
                z = (z ^ (z >> 31)) * 0xBF58476D1CE4E5B9ULL;
                sum += z >> 40;
            }
            bell[i] = static_cast<double>(static_cast<int32_t>(sum)) * 0x1p-24 - 6.0;
        }
}

// -- a tick -------------------------------------------------------------------------------------

// Calls work for as many parts at once as are left, at most `most`.
template <int most, class Work> inline void by(const int *parts, int left, Work &&work) {
    for (; left >= most; left -= most, parts += most) work.template operator()<most>(parts);
    if constexpr (most > 1) by<most - 1>(parts, left, work);
}

constexpr int most_chunks = lane_count / chunk_size, most_vectors = 4;
// Two at once fill the registers; with few steps in a tick there is enough to do beside them.
constexpr int most_coarse = most_chunks < 2 ? most_chunks : 2;

// What is still in the end of a tick is so from its beginning.
inline void note_held(Tick &t, int chunk) {
    for (int i = chunk; i < chunk + chunk_size; i += width)
        *reinterpret_cast<Mask *>(t.g.still + i) = still(t, i) | held_by_friction(t, i);
}

// Chunks that all of their lanes leave pushing, in the same steps.
template <bool coarse>
inline void glide_all(Tick &t, const Chunks &gliding, Substeps substeps, Chunks &others, TickEvents &events) {
    by<coarse ? most_coarse : most_chunks>(gliding.at, gliding.count, [&]<int count>(const int *chunks) {
        glide<count, coarse>(t, chunks, substeps, others, events);
    });
}

// Any others: each axis in its own steps. A vector of which all lanes have been moved, or are still, is left
// alone.
inline void move_others(Tick &t, const Chunks &others, Substeps substeps, TickEvents &events) {
    Done done = {};
    Vectors left;
    const bool longer = substeps.pushing != substeps.all;
    for (int k = 0; k < others.count; ++k) {
        const int c = others.at[k];
        for (int i = c; i < c + chunk_size; i += width) {
            store(t.turned_rad + i, V{});
            store(t.gear_ahead_rad + i, load(t.gear_start_rad + i));
        }
        const auto idle = [&](int i, int) { return ~sets_out_pushing(t, i) | still(t, i); };
        if (longer && !all_of_chunk(c, idle)) move_coarsely(t, c, substeps, done);
        for (int i = c; i < c + chunk_size; i += width)
            if (!all(moved_or_still(t, i, done))) left.add(i);
    }
    by<most_vectors>(left.at, left.count,
                     [&]<int count>(const int *vectors) { move<count>(t, vectors, substeps.all, done); });
    for (int k = 0; k < others.count; ++k) end_ways_of_chunk(t, others.at[k], events);
}

TickEvents step(AxisGroup &g, Substeps substeps) {
    Tick t(g);
    TickEvents events;
    Chunks gliding, others;
    for (int c = 0; c < lane_count; c += chunk_size) {
        if (all_of_chunk(c, [&](int i, int) { return still(t, i); })) continue;
        begin_ways_of_chunk(t, c);
        const auto pushes = [&](int i, int) { return sets_out_pushing(t, i); };
        if (!all_of_chunk(c, pushes)) note_held(t, c);
        (all_of_chunk(c, pushes) ? gliding : others).add(c);
    }
    if (substeps.pushing == substeps.all)
        glide_all<false>(t, gliding, substeps, others, events);
    else
        glide_all<true>(t, gliding, substeps, others, events);
    move_others(t, others, substeps, events);
    return events;
}

} // namespace

extern const Kernel FL_KERNEL_SYMBOL;
const Kernel FL_KERNEL_SYMBOL = {FL_KERNEL_NAME, sense,       drive,     step,      bells,
                                 hall_law,       advance_law, drive_law, settle_law};

} // namespace fl::twin
