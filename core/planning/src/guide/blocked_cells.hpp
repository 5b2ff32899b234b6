// Which cells of one positioner touch a neighbour that is at one of its own cells. They are kept: a neighbour
// passes the same places on most of its paths.
#pragma once

#include "bodies/touch_table.hpp"
#include "guide/key_table.hpp"
#include "motion/robot.hpp"

#include <cstdint>
#include <utility>

namespace fl::planning {

// A bit for each of sixteen cells of a line of beta; each line begins with a block of its own.
using CellBlock = std::uint16_t;

// The cells of lines first .. end - 1, as many blocks for each line as it has; those of all others are free.
struct BlockedLines {
    int first = 0, end = 0;
    const CellBlock *bits = nullptr;
};

class BlockedCells {
  public:
    static constexpr int block = 16; // cells

    static int blocks_per_line(const Robot &robot) { return (robot.alpha().size() + block - 1) / block; }

    // The cells of `me`, always the same, less than need_mm beyond both extra radii from `neighbour`, the one
    // at place `slot` among its neighbours, when that is at a cell. Of plain arms as precise as the table,
    // of others as single precision. Valid until the next call.
    BlockedLines by(const Robot &me, int slot, const Robot &neighbour, Cell at, double need_mm,
                    TouchTables &tables);

  private:
    // What is kept of a place of a neighbour.
    struct Kept {
        int begin = 0; // in blocks_
        std::int16_t first = 0, end = 0;
    };
    BlockedLines lines(const Kept &kept) const { return {kept.first, kept.end, blocks_.data() + kept.begin}; }
    Kept keep(int width, bool borders);
    std::pair<int, int> used_blocks() const;
    void fill(int width, int first, int last);
    // Directions from the centre of the robot.
    struct Sector {
        double middle_rad = 0.0, half_rad = 0.0;
    };
    // A line of cells: the centre lines of the arm, or of one limb of it, seen from its centre.
    struct Line {
        List<float> from_x, from_y, along_x, along_y; // at each line of alpha, mm
        double far_mm = 0.0;
        Sector first; // at the first line of alpha
    };

    static Sector sector(Segment line, double around_mm);
    // A line that cells may touch, seen from the centre, with all that is so near to it.
    struct Seen {
        Seen(const Segment &at, double around_mm)
            : line(at), away_mm(distance(at, {})), sector(BlockedCells::sector(at, around_mm)) {}
        Segment line;
        double away_mm;
        Sector sector;
    };
    using Lines = List<Line>; // of a limb
    void lay_out(const Robot &me);
    Lines laid_out(const Robot &me, const Limb *limb) const;
    void look_all(const Robot &me, const Robot &neighbour, Cell at, double need_mm);
    void look(const Lines &lines, int blocks, const Seen &seen, double need_mm, CellBlock *out);
    struct Other;

    // Plain arms, whose directions tell where they touch.
    struct Elbows {
        List<float> x, y;             // at each line of alpha, from the centre, mm
        List<std::int32_t> direction; // of the arm there, at the first line of beta, in parts of a turn
        // Where the first line of beta begins in a look that is at so many parts of a turn above the first,
        // or more.
        List<int> begin_at;
    };
    void lay_out_elbows(const Robot &me);
    bool look_up(const Robot &me, const Robot &neighbour, Cell at, double need_mm, TouchTables &tables);
    void mark(const TouchTable &table, Vec2 elbow, TurnPart direction, CellBlock *out) const;
    void mark_borders(Directions directions, CellBlock bit, CellBlock *column) const;

    KeyTable<Kept> kept_; // for each neighbour and place that was looked at
    List<CellBlock> blocks_;
    List<CellBlock> look_;     // one look, a line beyond the last one and some blocks
    List<CellBlock> on_alpha_; // of one look: a line of cells in which limbs on the alpha arm touch
    Elbows elbows_;
    List<Lines> lines_;   // of each limb; of one body without a shape
    List<Sector> groups_; // of cells that are looked at at once: their alpha, from that of the first line
};

} // namespace fl::planning
