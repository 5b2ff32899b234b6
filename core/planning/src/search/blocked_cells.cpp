#include "search/blocked_cells.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fl::planning {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double too_near_mm = 1.0; // to the centre, to have a sector of directions
constexpr double margin_rad = 1e-4;

double wrapped(double angle_rad) { return std::remainder(angle_rad, 2.0 * pi); }

float clamped01(float t) { return t < 0.0f ? 0.0f : (t > 1.0f ? 1.0f : t); }
float lower(float a, float b) { return a < b ? a : b; }

} // namespace

const CellBits *BlockedCells::by(const Robot &me, int slot, const Robot &neighbour, Cell at, double need_mm) {
    if (slot >= begins_.size()) begins_.resize(slot + 1);
    auto &begins = begins_[slot];
    if (begins.empty()) begins.assign(neighbour.cells(), -1);
    int &begin = begins[neighbour.index(at)];
    if (begin < 0) {
        begin = bits_.size();
        bits_.resize(begin + words(me), 0);
        look_all(me, neighbour, at, need_mm, bits_.data() + begin);
    }
    return bits_.data() + begin;
}

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
    for (int alpha = 0; alpha < me.alpha().size(); ++alpha)
        alpha_rad_.push_back(me.alpha().angle(alpha) - me.alpha().angle(0));
    touches_.resize(me.alpha().size());
    if (me.shape() == nullptr) lines_.push_back(laid_out(me, nullptr));
    for (int k = 0; me.shape() != nullptr && k < me.shape()->limbs.size(); ++k)
        lines_.push_back(laid_out(me, &me.shape()->limbs[k]));
}

// limb: none of a body without a shape.
BlockedCells::Lines BlockedCells::laid_out(const Robot &me, const Limb *limb) const {
    Lines lines;
    for (int beta = 0; beta < me.beta().size(); ++beta) {
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
        lines.push_back(std::move(line));
    }
    return lines;
}

// Every limb of the one with every limb of the other.
void BlockedCells::look_all(const Robot &me, const Robot &neighbour, Cell at, double need_mm, CellBits *out) {
    if (lines_.empty()) lay_out(me);
    const Limbs mine(me.limbs()), theirs(neighbour.limbs());
    const Segment there = neighbour.line(at);
    all_limbs(mine, theirs, need_mm, [&](int a, int b, double need) {
        const Segment line = theirs.at(b, there);
        look(lines_[a], words_per_line(me), {line.a - me.centre(), line.b - me.centre()}, need, out);
        return true;
    });
}

// Looks only where both are seen in the same direction from the centre.
void BlockedCells::look(const Lines &lines, int words, const Segment &line, double need_mm, CellBits *out) {
    const double away = distance(line, {});
    const Sector there = sector(line, need_mm);
    const auto place = [&](double alpha_rad) {
        return static_cast<int>(std::lower_bound(alpha_rad_.begin(), alpha_rad_.end(), alpha_rad) -
                                alpha_rad_.begin());
    };
    for (int beta = 0; beta < lines.size(); ++beta) {
        const Line &cells = lines[beta];
        if (away >= cells.far_mm + need_mm) continue;
        const double half = cells.first.half_rad + there.half_rad;
        CellBits *bits_of_line = out + beta * words;
        if (half >= pi) {
            mark(cells, 0, alpha_rad_.size(), line, need_mm, bits_of_line);
            continue;
        }
        const double middle = wrapped(there.middle_rad - cells.first.middle_rad);
        for (double m = middle; m - half <= alpha_rad_.back(); m += 2.0 * pi)
            mark(cells, place(m - half), place(m + half), line, need_mm, bits_of_line);
    }
}

// Sets the bits of those that touch. The compiler makes one instruction of several cells here.
void BlockedCells::mark(const Line &cells, int begin, int end, const Segment &line, double need_mm,
                        CellBits *out) {
    const auto single = [](double x) { return static_cast<float>(x); };
    const auto inverse = [](float x) { return x > 0.0f ? 1.0f / x : 0.0f; };
    const float qx = single(line.a.x), qy = single(line.a.y);
    const float dx = single(line.b.x - line.a.x), dy = single(line.b.y - line.a.y);
    const float *fx = cells.from_x.data(), *fy = cells.from_y.data();
    const float *ax = cells.along_x.data(), *ay = cells.along_y.data();
    const float theirs = inverse(dx * dx + dy * dy), mine = inverse(ax[0] * ax[0] + ay[0] * ay[0]);
    const float need2 = single(need_mm * need_mm);
    int *touches = touches_.data();
    for (int k = begin; k < end; ++k) {
        const float rx = fx[k] - qx, ry = fy[k] - qy; // my first end from their first
        const float sx = rx + ax[k], sy = ry + ay[k]; // my second
        const float ux = dx - rx, uy = dy - ry;       // their second from my first
        const float t0 = clamped01((rx * dx + ry * dy) * theirs),
                    t1 = clamped01((sx * dx + sy * dy) * theirs);
        const float t2 = clamped01(-(rx * ax[k] + ry * ay[k]) * mine),
                    t3 = clamped01((ux * ax[k] + uy * ay[k]) * mine);
        const float x0 = rx - t0 * dx, y0 = ry - t0 * dy, x1 = sx - t1 * dx, y1 = sy - t1 * dy;
        const float x2 = rx + t2 * ax[k], y2 = ry + t2 * ay[k], x3 = ux - t3 * ax[k], y3 = uy - t3 * ay[k];
        const float d2 =
            lower(lower(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1), lower(x2 * x2 + y2 * y2, x3 * x3 + y3 * y3));
        const float sides = (dx * ry - dy * rx) * (dx * sy - dy * sx);
        const float others = (ry * ax[k] - rx * ay[k]) * (ay[k] * ux - ax[k] * uy);
        touches[k] =
            static_cast<int>(d2 < need2) | (static_cast<int>(sides < 0.0f) & static_cast<int>(others < 0.0f));
    }
    for (int k = begin; k < end; ++k) out[k / bits] |= static_cast<CellBits>(touches[k]) << k % bits;
}

} // namespace fl::planning
