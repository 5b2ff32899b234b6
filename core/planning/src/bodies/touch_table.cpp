#include "bodies/touch_table.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fl::planning {
namespace {

constexpr double pi = std::numbers::pi;
constexpr int most_tables = 8; // 0.2 MB each

Vec2 operator*(double k, Vec2 v) { return {k * v.x, k * v.y}; }
Vec2 operator+(Vec2 p, Vec2 q) { return {p.x + q.x, p.y + q.y}; }

// The point of a segment that is nearest to the origin.
Vec2 nearest(const Segment &s) {
    const Vec2 along = s.b - s.a;
    const double squared = dot(along, along);
    return squared > 0.0 ? s.a + clamp01(-dot(s.a, along) / squared) * along : s.a;
}

} // namespace

double direction_rad(Vec2 v) {
    const double x = std::abs(v.x), y = std::abs(v.y);
    const double low = arctan(std::min(x, y) / std::max(x, y));
    const double first = y > x ? 0.5 * pi - low : low;
    const double half = v.x < 0.0 ? pi - first : first;
    return v.y < 0.0 ? -half : half;
}

TurnPart part_of(double angle_rad) {
    return static_cast<TurnPart>(static_cast<std::int64_t>(std::floor(angle_rad * parts_per_rad + 0.5)));
}

// The least interval of directions that holds all that were added, as seen from one of them.
class TouchTable::Hull {
  public:
    explicit Hull(Vec2 inside) : inside_(inside) {}
    void add(Vec2 at, double half_rad) {
        const double way = direction_rad({dot(inside_, at), cross(inside_, at)});
        low_ = std::min(low_, way - half_rad);
        high_ = std::max(high_, way + half_rad);
    }
    Directions directions() const {
        const double first = direction_rad(inside_) + low_;
        return {part_of(first), std::max<TurnPart>(part_of(high_ - low_), 1)};
    }

  private:
    Vec2 inside_;
    double low_ = 0.0, high_ = 0.0;
};

// Discs around the nearest place and the ends: their tangents, or where the end of the arm comes to their
// rims.
void TouchTable::add_ends(const Segment &other, Hull &hull) const {
    const double reach = arms_.mine_mm, need = arms_.need_mm;
    for (const Vec2 at : {nearest(other), other.a, other.b}) {
        const double d = length(at);
        if (d >= reach + need) continue;
        const double touch = d * d - need * need; // squared length of the tangent
        if (touch <= reach * reach) {
            hull.add(at, direction_rad({std::sqrt(std::max(touch, 0.0)), need}));
        } else {
            const double along =
                0.5 * (reach * reach + d * d - need * need) / d; // of the end, towards the disc
            hull.add(at, direction_rad({along, std::sqrt(std::max(reach * reach - along * along, 0.0))}));
        }
    }
}

// The lines beside the other: where the end of the arm comes to them.
void TouchTable::add_sides(const Segment &other, Hull &hull) const {
    const Vec2 along = (1.0 / arms_.theirs_mm) * (other.b - other.a), across{-along.y, along.x};
    const double off = dot(other.a, across), from = dot(other.a, along);
    for (const double side : {off - arms_.need_mm, off + arms_.need_mm}) {
        const double squared = arms_.mine_mm * arms_.mine_mm - side * side;
        if (squared <= 0.0) continue;
        for (const double way : {-std::sqrt(squared), std::sqrt(squared)})
            if (way >= from && way <= from + arms_.theirs_mm) hull.add(way * along + side * across, 0.0);
    }
}

Directions TouchTable::touching(double elbows_mm, Turn theirs) const {
    const Segment other{{elbows_mm, 0.0},
                        {elbows_mm + arms_.theirs_mm * theirs.c, arms_.theirs_mm * theirs.s}};
    const Vec2 near = nearest(other);
    const double least = length(near);
    if (least >= arms_.mine_mm + arms_.need_mm) return {};
    if (least <= arms_.need_mm) return {0, 0xffff};
    Hull hull(near);
    add_ends(other, hull);
    add_sides(other, hull);
    return hull.directions();
}

TouchTable::TouchTable(const Arms &arms) : arms_(arms) {
    const double reach = arms.mine_mm + arms.theirs_mm + arms.need_mm;
    squared_reach_mm2_ = static_cast<float>(reach * reach);
    const int rows = static_cast<int>(squared_reach_mm2_ / row_mm2) + 1;
    rows_.resize(rows * columns);
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < columns / 2; ++column) {
            const double elbows_mm = std::sqrt((row + 0.5) * row_mm2);
            const Directions d = touching(elbows_mm, turn((column + 0.5) * 2.0 * pi / columns));
            rows_[row * columns + column] = d;
            // mirrored at the line between the elbows
            const TurnPart first = static_cast<TurnPart>(-(d.first + d.width));
            rows_[(row + 1) * columns - 1 - column] = {first, d.width};
        }
}

const TouchTable *TouchTables::of(const TouchTable::Arms &arms) {
    for (const TouchTable &table : tables_)
        if (table.arms() == arms) return &table;
    if (tables_.size() >= most_tables) return nullptr;
    tables_.push_back(TouchTable(arms));
    return &tables_.back();
}

} // namespace fl::planning
