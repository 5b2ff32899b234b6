#include "normals.hpp"
#include "../machine.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <numbers>

namespace fl::metrology {
namespace {

constexpr int part_bits = 11, place_bits = 16 - part_bits;
constexpr int part_count = 1 << part_bits, tail_parts = 8;
constexpr std::size_t middle_count = 4096;

std::uint64_t splitmix(std::uint64_t &seed) {
    seed += 0x9E3779B97F4A7C15u;
    std::uint64_t z = seed;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double density(double x) { return std::exp(-0.5 * x * x) / std::sqrt(2 * std::numbers::pi); }

// Where the distribution has reached a share, by Newton from below.
double quantile(double share, double from) {
    double x = from;
    for (int i = 0; i < 20; ++i) {
        const double step = (0.5 * std::erfc(-x / std::sqrt(2.0)) - share) / density(x);
        x -= step;
        if (std::fabs(step) < 1e-12) break;
    }
    return x;
}

using Middles = std::array<float, middle_count>;

// Quantiles at the middles of equal parts.
Middles middles() {
    Middles out{};
    double x = -4, squares = 0;
    for (std::size_t k = 0; k < middle_count; ++k) {
        x = quantile((static_cast<double>(k) + 0.5) / middle_count, x);
        out[k] = static_cast<float>(x);
        squares += x * x;
    }
    for (float &v : out) v *= static_cast<float>(std::sqrt(middle_count / squares));
    return out;
}

// A part of the distribution: its mean, and how wide it is.
struct alignas(8) Part {
    float mean, width;
};
using Parts = std::array<Part, part_count>;

// The mean by the density at both ends, which is the integral of x times the density. The outermost have no
// end.
Parts equal_parts() {
    Parts out{};
    double x = -4, before = 0, from = 0;
    for (std::size_t k = 0; k < part_count; ++k) {
        const bool last = k + 1 == part_count;
        if (!last) x = quantile(static_cast<double>(k + 1) / part_count, x);
        const double after = last ? 0.0 : density(x);
        out[k] = {static_cast<float>((before - after) * part_count), static_cast<float>(x - from)};
        before = after, from = x;
    }
    return out;
}

// Of a share below 0.075, by the rational functions of Wichura (1988, AS 241): to 1e-16 of itself.
double tail_quantile(double share) {
    const double root = std::sqrt(-std::log(share));
    if (root <= 5.0) {
        const double r = root - 1.6;
        const double over = ((((((7.74545014278341407640e-4 * r + 2.27238449892691845833e-2) * r +
                                 2.41780725177450611770e-1) *
                                    r +
                                1.27045825245236838258) *
                                   r +
                               3.64784832476320460504) *
                                  r +
                              5.76949722146069140550) *
                                 r +
                             4.63033784615654529590) *
                                r +
                            1.42343711074968357734;
        const double under = ((((((1.05075007164441684324e-9 * r + 5.47593808499534494600e-4) * r +
                                  1.51986665636164571966e-2) *
                                     r +
                                 1.48103976427480074590e-1) *
                                    r +
                                6.89767334985100004550e-1) *
                                   r +
                               1.67638483018380384940) *
                                  r +
                              2.05319162663775882187) *
                                 r +
                             1.0;
        return -over / under;
    }
    const double r = root - 5.0;
    const double over =
        ((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r + 1.24266094738807843860e-3) *
                r +
            2.65321895265761230930e-2) *
               r +
           2.96560571828504891230e-1) *
              r +
          1.78482653991729133580) *
             r +
         5.46378491116411436990) *
            r +
        6.65790464350110377720;
    const double under =
        ((((((2.04426310338993978564e-15 * r + 1.42151175831644588870e-7) * r + 1.84631831751005468180e-5) *
                r +
            7.86869131145613259100e-4) *
               r +
           1.48753612908506148525e-2) *
              r +
          1.36929880922735805310e-1) *
             r +
         5.99832206555887937690e-1) *
            r +
        1.0;
    return -over / under;
}

// Quantiles of the outermost parts but the last, which has no end: by polynomials through six places of each
// sixteenth of a part, to 1e-11 of themselves. A logarithm and two rational functions take four times as
// long.
class TailCurves {
  public:
    TailCurves() {
        for (int k = 0; k < nodes; ++k) node_[k] = 0.5 - 0.5 * std::cos(std::numbers::pi * (k + 0.5) / nodes);
        for (int piece = 0; piece < pieces; ++piece) {
            std::array<double, nodes> &c = curves_[static_cast<std::size_t>(piece)];
            for (int k = 0; k < nodes; ++k)
                c[k] = tail_quantile((1 + (piece + node_[k]) / sixteenths) / part_count);
            for (int order = 1; order < nodes; ++order) // Newton's divided differences
                for (int k = nodes - 1; k >= order; --k)
                    c[k] = (c[k] - c[k - 1]) / (node_[k] - node_[k - order]);
        }
    }

    // So far within a part, 0 to 1; `part`: from the end, 1 or more.
    double quantile(int part, double within) const {
        const double place = within * sixteenths;
        const int sixteenth = static_cast<int>(place);
        const double t = place - sixteenth;
        const std::array<double, nodes> &c =
            curves_[static_cast<std::size_t>((part - 1) * sixteenths + sixteenth)];
        double z = c[nodes - 1];
        for (int k = nodes - 1; k-- > 0;) z = c[k] + (t - node_[k]) * z;
        return z;
    }

  private:
    static constexpr int sixteenths = 16, nodes = 6, pieces = (tail_parts - 1) * sixteenths;
    double node_[nodes]; // of a sixteenth
    std::array<std::array<double, nodes>, pieces> curves_;
};

// A number of one of the outermost parts, so far within it.
float tail(int part, double within, const TailCurves &curves) {
    const bool upper = part >= part_count / 2;
    const int from_the_end = upper ? part_count - 1 - part : part;
    const double z =
        from_the_end == 0 ? tail_quantile(within / part_count) : curves.quantile(from_the_end, within);
    return static_cast<float>(upper ? -z : z);
}

constexpr int most_px = Normals::most * stretch_px;

// The next 16 bits of each pixel: its part, the place in it from -1/2 to 1/2, and whether it is an outermost
// one. Of several stretches: what is stored in small pieces has long been written when it is read in large
// ones.
struct Choices {
    alignas(64) std::uint16_t part[most_px];
    alignas(64) float place[most_px];
    alignas(64) unsigned char outermost[most_px];
};

std::uint64_t flags_of(const Choices &chosen, int first) {
    std::uint64_t eight;
    std::memcpy(&eight, &chosen.outermost[first], sizeof eight);
    return eight;
}

constexpr int lanes = Normals::lanes, words_of_lane = stretch_px / 4 / lanes;

// A lane at a time, in arrays: a vector of all eight lanes is copied in halves by way of the stack where a
// machine's vectors are shorter, and waits there for itself.
FL_CLONES void choose(std::uint64_t (*state)[lanes], int first, Choices &out) {
    std::uint16_t *chosen = &out.part[first];
    unsigned char *outermost = &out.outermost[first];
    float *place = &out.place[first];
    alignas(64) std::uint64_t words[words_of_lane][lanes];
    for (int lane = 0; lane < lanes; ++lane) {
        std::uint64_t s[4];
        for (int i = 0; i < 4; ++i) s[i] = state[i][lane];
        for (int k = 0; k < words_of_lane; ++k) {
            const std::uint64_t sum = s[0] + s[3], t = s[1] << 17;
            words[k][lane] = (sum << 23 | sum >> 41) + s[0];
            s[2] ^= s[0], s[3] ^= s[1], s[1] ^= s[2], s[0] ^= s[3];
            s[2] ^= t;
            s[3] = s[3] << 45 | s[3] >> 19;
        }
        for (int i = 0; i < 4; ++i) state[i][lane] = s[i];
    }
    using Bits = const std::uint16_t __attribute__((may_alias));
    Bits *bits = reinterpret_cast<Bits *>(words);
    constexpr int places = 1 << place_bits;
    for (int k = 0; k < stretch_px; ++k) {
        const std::uint16_t part = static_cast<std::uint16_t>(bits[k] >> place_bits);
        chosen[k] = part;
        // one comparison of 16 bits: those below wrap around
        const std::uint16_t inwards = static_cast<std::uint16_t>(part - tail_parts);
        outermost[k] = inwards >= part_count - 2 * tail_parts;
    }
    for (int k = 0; k < stretch_px; ++k)
        place[k] = (static_cast<float>(bits[k] & (places - 1)) - 0.5f * (places - 1)) / places;
}

using Float4 = float __attribute__((vector_size(16)));
using Int4 = std::int32_t __attribute__((vector_size(16)));
using Float4Anywhere = float __attribute__((vector_size(16), aligned(4)));
using Double2 = double __attribute__((vector_size(16)));

// A part is read whole, as it lies in the table; then the means of four are put beside each other, and the
// widths. Vectors of eight would be taken to pieces where a machine has none.
FL_CLONES void put(const Parts &table, const Choices &chosen, int count, float *z) {
    using Whole = const double __attribute__((may_alias));
    Whole *parts = reinterpret_cast<Whole *>(table.data());
    for (int k = 0; k < count; k += 4) {
        const std::uint16_t *p = &chosen.part[k];
        const Double2 first = {parts[p[0]], parts[p[1]]}, second = {parts[p[2]], parts[p[3]]};
        const Float4 a = reinterpret_cast<Float4>(first), b = reinterpret_cast<Float4>(second);
        const Float4 mean = __builtin_shuffle(a, b, Int4{0, 2, 4, 6});
        const Float4 width = __builtin_shuffle(a, b, Int4{1, 3, 5, 7});
        const Float4 place = *reinterpret_cast<const Float4 *>(&chosen.place[k]);
        *reinterpret_cast<Float4Anywhere *>(&z[k]) = mean + place * width;
    }
}

} // namespace

Random::Random(std::uint64_t seed) {
    for (std::uint64_t &word : state_) word = splitmix(seed);
}

double normal(Random &random) {
    static const Middles table = middles();
    const std::uint64_t b = random.bits();
    const float upper = table[b >> 52] + table[(b >> 40) & 4095];
    const float lower = table[(b >> 28) & 4095] + table[(b >> 16) & 4095];
    return static_cast<double>(0.5f * (upper + lower));
}

Normals::Normals(std::uint64_t seed) : tails_(seed ^ 0x5851F42D4C957F2Du) {
    for (auto &words : state_)
        for (std::uint64_t &word : words) word = splitmix(seed);
}

void Normals::draw(int stretches, float *z) {
    static const Parts table = equal_parts();
    static const TailCurves curves;
    Choices chosen;
    const int count = stretches * stretch_px;
    for (int first = 0; first < count; first += stretch_px) choose(state_, first, chosen);
    put(table, chosen, count, z);
    // which eights have one, without a guess that may be wrong; few have two
    int eights[most_px / 8], found = 0;
    for (int first = 0; first < count; first += 8) {
        eights[found] = first;
        found += flags_of(chosen, first) != 0;
    }
    for (int i = 0; i < found; ++i)
        for (std::uint64_t left = flags_of(chosen, eights[i]); left != 0; left &= left - 1) {
            const int k = eights[i] + std::countr_zero(left) / 8;
            const double within = tails_.uniform() + 0x1p-54; // never 0: the middle of a step
            z[k] = tail(chosen.part[k], within, curves);
        }
}

} // namespace fl::metrology
