#include "guide/blocked_cells.hpp"

#include "motion/clones.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numbers>

namespace fl::planning {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double too_near_mm = 1.0; // to the centre, to have a sector of directions
constexpr double margin_rad = 1e-4;

constexpr int line_bits = 6, line_bins = 1 << (16 - line_bits); // of directions in which lines are looked up

constexpr int at_once = 8;         // cells
constexpr int at_a_time = 4;       // blocks
constexpr float nowhere_mm = 1e6f; // where nothing is, for the places beyond the last cell of a line

using Float8 = float __attribute__((vector_size(32)));
using Int8 = std::int32_t __attribute__((vector_size(32)));

// Into -pi .. pi; most angles are nearly there.
inline double wrapped(double angle_rad) {
    while (angle_rad > pi) angle_rad -= 2.0 * pi;
    while (angle_rad < -pi) angle_rad += 2.0 * pi;
    return angle_rad;
}

float single(double x) { return static_cast<float>(x); }
float inverse(float x) { return x > 0.0f ? 1.0f / x : 0.0f; }

FL_INLINE Float8 all(float v) { return Float8{v, v, v, v, v, v, v, v}; }
FL_INLINE Float8 load(const float *p) {
    Float8 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
FL_INLINE Int8 load(const std::int32_t *p) {
    Int8 v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
FL_INLINE Float8 lower(Float8 a, Float8 b) { return a < b ? a : b; }
FL_INLINE Float8 clamped01(Float8 t) {
    const Float8 above = t > all(0.0f) ? t : all(0.0f);
    return lower(above, all(1.0f));
}
FL_INLINE Float8 higher(Float8 a, Float8 b) { return a < b ? b : a; }
FL_INLINE Float8 positive(Float8 a) { return a < all(0.0f) ? -a : a; }
// The directions of eight vectors, in parts of a turn; as `direction_of`.
FL_INLINE Int8 directions_of(Float8 x, Float8 y) {
    const Float8 ax = positive(x), ay = positive(y);
    const Float8 low = arctan(lower(ax, ay) / higher(ax, ay));
    const Float8 first = ay > ax ? all(single(0.5 * pi)) - low : low;
    const Float8 half = x < all(0.0f) ? all(single(pi)) - first : first;
    const Float8 angle = y < all(0.0f) ? -half : half;
    return __builtin_convertvector(angle * single(parts_per_rad) + 65536.5f, Int8);
}
// So many blocks as are taken at a time.
FL_INLINE std::uint64_t some_blocks(const CellBlock *first) {
    std::uint64_t word;
    static_assert(sizeof word == at_a_time * sizeof *first);
    std::memcpy(&word, first, sizeof word);
    return word;
}
// Bit k where the lane k of the mask is set.
FL_INLINE std::uint64_t bits_of(Int8 mask) {
    mask &= Int8{1, 2, 4, 8, 16, 32, 64, 128};
    std::uint64_t two[4];
    std::memcpy(two, &mask, sizeof two);
    const std::uint64_t some = (two[0] | two[1]) | (two[2] | two[3]);
    return (some | some >> 32) & 0xff;
}

} // namespace

BlockedLines BlockedCells::by(const Robot &me, int slot, const Robot &neighbour, Cell at, double need_mm,
                              TouchTables &tables) {
    const std::uint64_t place =
        static_cast<std::uint64_t>(slot) << 32 | static_cast<std::uint32_t>(neighbour.index(at));
    if (const Kept *known = kept_.find(place)) return lines(*known);
    look_.assign((me.beta().size() + 1) * blocks_per_line(me) + at_a_time, 0);
    const bool borders = look_up(me, neighbour, at, need_mm, tables);
    if (!borders) look_all(me, neighbour, at, need_mm);
    const Kept kept = keep(blocks_per_line(me), borders);
    kept_.add(place, kept);
    return lines(kept);
}

// The lines of the last look that have any, from the first to the last one.
BlockedCells::Kept BlockedCells::keep(int width, bool borders) {
    const int begin = blocks_.size();
    const auto [first_used, end_used] = used_blocks();
    const int first = first_used / width;
    // no cell is beyond the last border
    const int end = borders ? (end_used - 1) / width : (end_used + width - 1) / width;
    if (borders) fill(width, first, end);
    blocks_.insert(blocks_.end(), look_.begin() + first * width, look_.begin() + end * width);
    return {begin, static_cast<std::int16_t>(first), static_cast<std::int16_t>(end)};
}

// From the first one of the last look that is not empty to the one after the last; 0, 0: all are.
std::pair<int, int> BlockedCells::used_blocks() const {
    const auto empty = [&](int from) { return some_blocks(&look_[from]) == 0; };
    int first = 0, end = look_.size() / at_a_time * at_a_time; // beyond the lines there are so many more
    while (first < end && empty(first)) first += at_a_time;
    if (first == end) return {0, 0};
    while (empty(end - at_a_time)) end -= at_a_time;
    while (look_[first] == 0) ++first;
    while (look_[end - 1] == 0) --end;
    return {first, end};
}

void BlockedCells::lay_out_elbows(const Robot &me) {
    for (int alpha = 0; alpha < me.alpha().size(); ++alpha) {
        const Segment arm = me.line({alpha, 0});
        elbows_.x.push_back(single(arm.a.x - me.centre().x));
        elbows_.y.push_back(single(arm.a.y - me.centre().y));
        elbows_.direction.push_back(direction_of(arm.b - arm.a));
    }
    while (elbows_.x.size() % at_once != 0) {
        elbows_.x.push_back(nowhere_mm);
        elbows_.y.push_back(0.0f);
        elbows_.direction.push_back(0);
    }
    int line = 0;
    for (int bin = 0; bin <= line_bins; ++bin) {
        const double from_rad = me.beta().angle(0) + (bin << line_bits) / parts_per_rad;
        while (line < me.beta().size() && me.beta().angle(line) < from_rad - margin_rad) ++line;
        elbows_.begin_at.push_back(line * blocks_per_line(me));
    }
}

// False if there is no table for the two.
bool BlockedCells::look_up(const Robot &me, const Robot &neighbour, Cell at, double need_mm,
                           TouchTables &tables) {
    const double turn = me.beta().angle(me.beta().size() - 1) - me.beta().angle(0);
    if (!me.from_elbow() || !neighbour.from_elbow() || turn > 2.0 * pi - margin_rad) return false;
    const TouchTable *table =
        tables.of({me.length_mm(), neighbour.length_mm(), need_mm + me.extra_mm() + neighbour.extra_mm()});
    if (table == nullptr) return false;
    if (elbows_.x.empty()) lay_out_elbows(me);
    const Segment there = neighbour.line(at);
    mark(*table, there.a - me.centre(), direction_of(there.b - there.a), look_.data());
    return true;
}

// A cell is as the one on the line below unless there is a border between them.
void BlockedCells::fill(int width, int first, int last) {
    CellBlock *const end = &look_[last * width];
    CellBlock *here = &look_[first * width] + width;
    if (width < at_a_time) {
        for (; here < end; ++here) *here ^= *(here - width);
        return;
    }
    // there are lines beyond the end, longer than what is done at a time
    for (; here < end; here += at_a_time) {
        const std::uint64_t word = some_blocks(here) ^ some_blocks(here - width);
        std::memcpy(here, &word, sizeof word);
    }
}

// Of the cells that touch an arm with its elbow at a place, from the centre: sets the bits of those that do
// where the one on the line below does not, or the other way round.
FL_CLONES void BlockedCells::mark(const TouchTable &table, Vec2 elbow, TurnPart direction,
                                  CellBlock *out) const {
    const float reach = table.squared_reach_mm2();
    for (int first = 0; first < elbows_.direction.size(); first += at_once) {
        const Float8 x = single(elbow.x) - load(&elbows_.x[first]),
                     y = single(elbow.y) - load(&elbows_.y[first]);
        const Float8 squared = x * x + y * y;
        std::uint64_t near = bits_of(squared < all(reach));
        if (near == 0) continue;
        const Int8 bearings = directions_of(x, y);
        // of elbows that are beyond the reach no place is asked for
        const Float8 within = squared < all(reach) ? squared : all(0.0f);
        const Int8 rows = __builtin_convertvector(within * (1.0f / TouchTable::row_mm2), Int8);
        const Int8 places = TouchTable::place_of(rows, direction - bearings);
        const Int8 turned = bearings - load(&elbows_.direction[first]);
        for (; near != 0; near &= near - 1) {
            const int k = std::countr_zero(near);
            Directions d = table.at(places[k]);
            d.first = static_cast<TurnPart>(d.first + turned[k]);
            if (d.width > 0)
                mark_borders(d, static_cast<CellBlock>(1 << (first % block + k)), out + first / block);
        }
    }
}

// Of the cells on a line of alpha: a bit of one block of each line of beta. Directions are those above the
// first line of beta.
FL_INLINE void BlockedCells::mark_borders(Directions d, CellBlock bit, CellBlock *column) const {
    const int *begin_at = elbows_.begin_at.data();
    const int end = d.first + d.width, wrapped = end - 65536; // beyond a whole turn lines begin anew
    const int first = begin_at[d.first >> line_bits];
    column[first] ^= bit;
    column[begin_at[std::min(end >> line_bits, line_bins - 1) + 1]] ^= bit;
    if (wrapped < 0) return;
    column[0] ^= bit;
    column[std::min(begin_at[(wrapped >> line_bits) + 1], first)] ^= bit;
}

// A line that those of cells may touch; these are all of one length.
struct BlockedCells::Other {
    float x, y, dx, dy, inverse2, our_inverse2, need2;

    Other(const Segment &line, const Line &ours, double need_mm)
        : x(single(line.a.x)), y(single(line.a.y)), dx(single(line.b.x - line.a.x)),
          dy(single(line.b.y - line.a.y)), inverse2(inverse(dx * dx + dy * dy)),
          our_inverse2(inverse(ours.along_x[0] * ours.along_x[0] + ours.along_y[0] * ours.along_y[0])),
          need2(single(need_mm * need_mm)) {}

    // Which of eight cells, from the k-th on, are nearer to it than need be, or cross it.
    FL_INLINE Int8 touches(const Line &cells, int k) const {
        const Float8 ax = load(&cells.along_x[k]), ay = load(&cells.along_y[k]);
        const Float8 rx = load(&cells.from_x[k]) - x, ry = load(&cells.from_y[k]) - y; // our first end
        const Float8 sx = rx + ax, sy = ry + ay;                                       // our second
        const Float8 ux = dx - rx, uy = dy - ry; // its second from our first
        const Float8 t0 = clamped01((rx * dx + ry * dy) * inverse2),
                     t1 = clamped01((sx * dx + sy * dy) * inverse2);
        const Float8 t2 = clamped01(-(rx * ax + ry * ay) * our_inverse2),
                     t3 = clamped01((ux * ax + uy * ay) * our_inverse2);
        const Float8 x0 = rx - t0 * dx, y0 = ry - t0 * dy, x1 = sx - t1 * dx, y1 = sy - t1 * dy;
        const Float8 x2 = rx + t2 * ax, y2 = ry + t2 * ay, x3 = ux - t3 * ax, y3 = uy - t3 * ay;
        const Float8 d2 =
            lower(lower(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1), lower(x2 * x2 + y2 * y2, x3 * x3 + y3 * y3));
        const Float8 sides = (dx * ry - dy * rx) * (dx * sy - dy * sx);
        const Float8 others = (ry * ax - rx * ay) * (ay * ux - ax * uy);
        return (d2 < all(need2)) | ((sides < all(0.0f)) & (others < all(0.0f)));
    }
};

// Where a line is seen from the centre, with all that is around it. All directions if it is too near.
BlockedCells::Sector BlockedCells::sector(Segment line, double around_mm) {
    if (distance(line, {}) < around_mm + too_near_mm) return {0.0, pi};
    const double first = std::atan2(line.a.y, line.a.x);
    const double way = wrapped(std::atan2(line.b.y, line.b.x) - first);
    const double before = std::asin(around_mm / length(line.a)),
                 after = std::asin(around_mm / length(line.b));
    // the two discs at its ends, from the one side to the other
    const double low = std::min(-before, way - after), high = std::max(before, way + after);
    return {first + 0.5 * (low + high), 0.5 * (high - low) + margin_rad};
}

void BlockedCells::lay_out(const Robot &me) {
    const AxisGrid &alpha = me.alpha();
    for (int first = 0; first < alpha.size(); first += at_once) {
        const double from = alpha.angle(first), to = alpha.angle(std::min(first + at_once, alpha.size()) - 1);
        groups_.push_back({0.5 * (from + to) - alpha.angle(0), 0.5 * (to - from)});
    }
    if (me.shape() == nullptr) lines_.push_back(laid_out(me, nullptr));
    for (int k = 0; me.shape() != nullptr && k < me.shape()->limbs.size(); ++k)
        lines_.push_back(laid_out(me, &me.shape()->limbs[k]));
}

// limb: none of a body without a shape. One on the alpha arm is at the same places on all lines of beta.
BlockedCells::Lines BlockedCells::laid_out(const Robot &me, const Limb *limb) const {
    Lines lines;
    const int different = limb != nullptr && limb->on_alpha ? 1 : me.beta().size();
    for (int beta = 0; beta < different; ++beta) {
        Line line;
        for (int alpha = 0; alpha < me.alpha().size(); ++alpha) {
            const Segment arm = me.line({alpha, beta});
            const Segment s = limb == nullptr ? arm : me.shape()->place(*limb, arm);
            const Vec2 from = s.a - me.centre(), to = s.b - me.centre(), along = to - from;
            line.from_x.push_back(static_cast<float>(from.x));
            line.from_y.push_back(static_cast<float>(from.y));
            line.along_x.push_back(static_cast<float>(along.x));
            line.along_y.push_back(static_cast<float>(along.y));
            line.far_mm = std::max({line.far_mm, length(from), length(to)});
            if (alpha == 0) line.first = sector({from, to}, 0.0);
        }
        while (line.from_x.size() % at_once != 0) {
            line.from_x.push_back(nowhere_mm);
            for (List<float> *rest : {&line.from_y, &line.along_x, &line.along_y}) rest->push_back(0.0f);
        }
        lines.push_back(std::move(line));
    }
    return lines;
}

// Every limb of the one with every limb of the other.
void BlockedCells::look_all(const Robot &me, const Robot &neighbour, Cell at, double need_mm) {
    if (lines_.empty()) lay_out(me);
    const Limbs mine(me.limbs()), theirs(neighbour.limbs());
    const Segment there = neighbour.line(at);
    double widest_mm = 0.0;
    for (int a = 0; a < mine.size(); ++a) widest_mm = std::max(widest_mm, mine.extra_mm(a));
    on_alpha_.assign(blocks_per_line(me), 0);
    for (int b = 0; b < theirs.size(); ++b) {
        const Segment line = theirs.at(b, there);
        const double need = need_mm + theirs.extra_mm(b);
        const Seen seen({line.a - me.centre(), line.b - me.centre()}, need + widest_mm);
        for (int a = 0; a < mine.size(); ++a)
            if (may_touch(mine, a, theirs, b))
                look(lines_[a], blocks_per_line(me), seen, need + mine.extra_mm(a),
                     mine.on_alpha(a) ? on_alpha_.data() : look_.data());
    }
    for (int k = 0; k < me.beta().size() * blocks_per_line(me); ++k)
        look_[k] |= on_alpha_[k % on_alpha_.size()];
}

// Sets the bits of the cells that touch a line; looks only where both are seen in the same direction from
// the centre.
FL_CLONES void BlockedCells::look(const Lines &lines, int blocks, const Seen &seen, double need_mm,
                                  CellBlock *out) {
    const Sector &there = seen.sector;
    const Other other(seen.line, lines.front(), need_mm);
    for (int beta = 0; beta < lines.size(); ++beta, out += blocks) {
        const Line &cells = lines[beta];
        if (seen.away_mm >= cells.far_mm + need_mm) continue;
        const double middle = wrapped(there.middle_rad - cells.first.middle_rad);
        const double half = cells.first.half_rad + there.half_rad;
        for (int group = 0; group < groups_.size(); ++group) {
            const Sector &here = groups_[group];
            if (std::abs(wrapped(here.middle_rad - middle)) > here.half_rad + half) continue;
            const int k = group * at_once;
            out[k / block] |= static_cast<CellBlock>(bits_of(other.touches(cells, k)) << k % block);
        }
    }
}

} // namespace fl::planning
