// Which cells of one positioner touch a neighbour that is at one of its own cells. They are kept: a neighbour
// passes the same places on most of its paths.
#pragma once

#include "bodies/touch_table.hpp"
#include "motion/robot.hpp"

#include <cstdint>

namespace fl::planning {

// A bit for each cell of a robot, line by line of beta; each line begins with a word of its own.
using CellBits = std::uint64_t;

class BlockedCells {
  public:
    static constexpr int bits = 64;

    static int words_per_line(const Robot &robot) { return (robot.alpha().size() + bits - 1) / bits; }
    static int words(const Robot &robot) { return robot.beta().size() * words_per_line(robot); }

    // The cells of `me`, always the same, less than need_mm beyond both extra radii from `neighbour`, the one
    // at place `slot` among its neighbours, when that is at a cell. Of plain arms as precise as the table,
    // of others as single precision. Valid until the next call.
    const CellBits *by(const Robot &me, int slot, const Robot &neighbour, Cell at, double need_mm,
                       TouchTables &tables);

  private:
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
    using Lines = List<Line>; // of a limb
    void lay_out(const Robot &me);
    Lines laid_out(const Robot &me, const Limb *limb) const;
    void look_all(const Robot &me, const Robot &neighbour, Cell at, double need_mm, CellBits *out);
    void look(const Lines &lines, int words, const Segment &line, double need_mm, CellBits *out);
    struct Other;

    // Plain arms, whose directions tell where they touch.
    struct Elbows {
        List<float> x, y;         // at each line of alpha, from the centre, mm
        List<TurnPart> direction; // of the arm there, at the first line of beta
        List<int> line_at; // the first line of beta at so many parts of a turn above the first, or more
    };
    void lay_out_elbows(const Robot &me);
    bool look_up(const Robot &me, const Robot &neighbour, Cell at, double need_mm, TouchTables &tables,
                 CellBits *out);
    void mark(const TouchTable &table, Vec2 elbow, TurnPart direction, int words, CellBits *out) const;
    void mark_borders(int alpha, Directions directions, int words, CellBits *out) const;

    int &begin_of(int slot, const Robot &neighbour, Cell at);

    // For each neighbour, line of alpha and line of beta of it: where its bits begin; -1: not looked at.
    // Lines of alpha on which it has never been are empty.
    List<List<List<int>>> begins_;
    List<CellBits> bits_;
    List<CellBits> borders_; // of one look
    Elbows elbows_;
    List<Lines> lines_;   // of each limb; of one body without a shape
    List<Sector> groups_; // of cells that are looked at at once: their alpha, from that of the first line
};

} // namespace fl::planning
