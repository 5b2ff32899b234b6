// In which directions a beta arm touches another one, by where their elbows are: a table for arms of one
// length.
//
// Whether two plain arms touch is told by three numbers: the distance of their elbows, and both directions
// against the line from the one elbow to the other. For a distance and a direction of the other arm, the
// directions in which the arm touches it are one interval: the other with all that is near to it is convex.
//
// Distances and directions are rounded: the answer is that for a place of the other up to 0.2 mm from where
// it is. That is enough for a guide, and for nothing else.
#pragma once

#include "motion/index.hpp"
#include "motion/swept_arm.hpp"
#include "motion/trig.hpp"

#include <cstdint>

namespace fl::planning {

// An angle in parts of a turn, 2^16 in all: sums wrap round by themselves.
using TurnPart = std::uint16_t;
inline constexpr double parts_per_rad = 65536.0 / 6.283185307179586477;

// arctan(t), 0 <= t <= 1, by additions and products alone; error below 2e-6.
template <class Number> inline Number arctan(Number t) {
    const Number z = t * t;
    const Number tail = ((z * -0.01172120f + 0.05265332f) * z - 0.11643287f) * z + 0.19354346f;
    return t * ((tail * z - 0.33262347f) * z + 0.99997726f);
}

// The direction of a vector that is not zero, -pi .. pi, with the error of arctan.
double direction_rad(Vec2 v);
TurnPart part_of(double angle_rad);
inline TurnPart direction_of(Vec2 v) { return part_of(direction_rad(v)); }

// From one direction on, so wide; 0: none.
struct Directions {
    TurnPart first = 0, width = 0;
};

class TouchTable {
  public:
    struct Arms {
        double mine_mm = 0.0, theirs_mm = 0.0; // from the elbow to the end
        double need_mm = 0.0;                  // between centre lines
        friend bool operator==(const Arms &, const Arms &) = default;
    };
    explicit TouchTable(const Arms &arms);

    const Arms &arms() const { return arms_; }
    // Elbows that are farther apart than the root of this never touch, mm^2.
    float squared_reach_mm2() const { return squared_reach_mm2_; }
    // Distances of the elbows that are taken together, squared.
    static constexpr float row_mm2 = 6.0f; // 0.2 mm at 8 mm either way, 0.05 mm at 30 mm
    // A place in the table, or several at once. row: the squared distance of the elbows in units of row_mm2,
    // without its fraction; theirs: the direction of the other, from that of its elbow, in parts of a turn.
    template <class Integer> static Integer place_of(Integer row, Integer theirs) {
        return row * columns + ((theirs & 0xffff) >> column_bits);
    }
    // Where the arm touches the other: from the direction of its elbow.
    // @pre the distance is below the reach.
    Directions at(int place) const { return rows_[place]; }

  private:
    static constexpr int column_bits = 8; // 1.4 deg each
    static constexpr int columns = 1 << (16 - column_bits);

    Directions touching(double elbows_mm, Turn theirs) const;
    class Hull;
    void add_ends(const Segment &other, Hull &hull) const;
    void add_sides(const Segment &other, Hull &hull) const;

    Arms arms_;
    float squared_reach_mm2_ = 0.0f;
    List<Directions> rows_;
};

// The tables of a plan, made when they are first asked for.
class TouchTables {
  public:
    // None if there are too many different arms.
    const TouchTable *of(const TouchTable::Arms &arms);

  private:
    List<TouchTable> tables_;
};

} // namespace fl::planning
