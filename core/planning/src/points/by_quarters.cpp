#include "points/by_quarters.hpp"

#include "points/axis_by_quarters.hpp"

#include <algorithm>
#include <optional>
#include <utility>

namespace fl::planning {
namespace {

// Both axes of a positioner.
struct WayByQuarters {
    explicit WayByQuarters(const Member &m)
        : axes{AxisByQuarters(m.robot.alpha(), m.path, &Cell::alpha),
               AxisByQuarters(m.robot.beta(), m.path, &Cell::beta)} {}
    int end() const { return std::max(axes[0].end(), axes[1].end()); }
    Angles sent(int quarter) const { return {axes[0].sent(quarter), axes[1].sent(quarter)}; }
    Cell nearest(int quarter) const { return {axes[0].nearest(quarter), axes[1].nearest(quarter)}; }

    AxisByQuarters axes[2];
};

// A move of one axis.
struct OneMove {
    PathIndex whose;
    int axis = 0, move = 0;
};

// What else goes earlier where two meet, or where the other axis has to: there is a choice, and one that
// fails says nothing of the others.
struct Choice {
    bool both_axes = false; // of those that arrive last, if both can
    bool own_first = false; // rather the other moves of the one that was pulled than those that it meets
    int first_axis = 0;     // of two axes that can ...
    bool one_axis = false;  // ... this one alone, if that is enough
};

constexpr int choices = 16;
constexpr Choice choice_of(int number) {
    return {(number & 1) != 0, (number & 4) != 0, number >> 3 & 1, (number & 2) != 0};
}

// The raw motion is on the cell of a step in this quarter; what is sent in the step begins two before it.
constexpr int middle_of(int step) { return quarters * step + 1; }
constexpr int begin_of(int step) { return middle_of(step) - quarters / 2; }

class Pulling {
  public:
    Pulling(PathSet &paths, const Enough &enough) : paths_(paths), enough_(enough), ways_(paths.size()) {
        for (const PathIndex i : paths_.places()) end_ = std::max(end_, end_of(i));
    }

    EarlierByQuarters run() {
        EarlierByQuarters out{0, List<OwnKnots, PathIndex>(paths_.size())};
        for (const Spare spare : {Spare::rests, Spare::rests_first, Spare::slower_first})
            out.quarters += quarters_less(spare);
        for (const PathIndex i : changed_)
            if (out.knots[i].empty()) out.knots[i] = {way(i).axes[0].knots(), way(i).axes[1].knots()};
        return out;
    }

  private:
    int end_of(PathIndex i) {
        if (paths_.at(i).still || paths_.arrival(i) == 0) return 0;
        return ways_[i] ? ways_[i]->end() : middle_of(paths_.arrival(i));
    }
    WayByQuarters &way(PathIndex i) {
        if (!ways_[i]) ways_[i].emplace(paths_.at(i));
        return *ways_[i];
    }

    int quarters_less(Spare spare);
    bool a_quarter_less();
    bool pull_last();
    bool pull_last_of(PathIndex i);
    bool ends_softly(PathIndex i);
    bool all_go_softly();
    bool pull(const OneMove &which);
    bool pull_around(PathIndex i, int step);
    void touch(PathIndex i);
    void sweep_anew(PathIndex i, int first_quarter, int last_quarter);
    bool part(PathIndex i);
    void end_attempt(bool keep);

    // One whose moves are pulled in an attempt, as it was before.
    struct Touched {
        SavedPath path;
        WayByQuarters way;
        int first = 0, last = 0; // steps in which it sweeps something else
    };
    Touched &touched(PathIndex i) {
        return *std::find_if(touched_.begin(), touched_.end(),
                             [i](const Touched &t) { return t.path.index == i; });
    }

    PathSet &paths_;
    const Enough &enough_;
    List<std::optional<WayByQuarters>, PathIndex> ways_;
    List<PathIndex> changed_;
    List<Touched> touched_;
    List<PathIndex> open_; // those that have to be tested, the first one first
    Choice choice_;
    Spare spare_ = Spare::rests;
    int end_ = 0; // quarter in which the last one arrives
};

// By so many the plan then ends earlier: by each choice as often as it can be, until none can.
int Pulling::quarters_less(Spare spare) {
    spare_ = spare;
    int less = 0;
    for (int tried = 0, next = 0; tried < choices && !enough_(); ++tried, next = (next + 1) % choices) {
        choice_ = choice_of(next);
        while (!enough_() && a_quarter_less()) {
            ++less;
            tried = 0;
        }
    }
    return less;
}

// All that arrive last, a quarter earlier, and those that they then meet, and so on. All as before if one of
// them cannot.
bool Pulling::a_quarter_less() {
    bool done = pull_last();
    while (done && !open_.empty()) {
        const PathIndex i = open_.front();
        open_.erase(open_.begin());
        done = part(i);
    }
    done = done && all_go_softly();
    end_attempt(done);
    if (done) --end_;
    return done;
}

bool Pulling::pull_last() {
    for (const PathIndex i : paths_.places())
        if (end_of(i) >= end_ - 1 && !pull_last_of(i)) return false;
    return end_ > 0;
}

// That which ends last, and what would then end a quarter before the end.
bool Pulling::pull_last_of(PathIndex i) {
    const bool last = end_of(i) == end_;
    for (const int axis : {0, 1}) {
        const AxisByQuarters &way = this->way(i).axes[axis];
        const int off = end_ - way.end();
        const bool must = off == 0 || off == 2;
        if (way.moves().empty() || !(must || (last && choice_.both_axes))) continue;
        if (!pull({i, axis, way.moves().size() - 1}) && must) return false;
    }
    return true;
}

// Where an axis ends, or changes its speed, a quarter before the end of the other, and the approach begins at
// once, it takes from the last corner half of the time in which the speed changes from the one to the other:
// more than the acceleration allows.
bool Pulling::ends_softly(PathIndex i) {
    if (end_of(i) != end_ - 1) return true;
    return way(i).axes[0].steady(end_ - 1) && way(i).axes[1].steady(end_ - 1);
}

// On a path, in whole steps, all do.
bool Pulling::all_go_softly() {
    for (const PathIndex i : paths_.places())
        if (ways_[i] && !ends_softly(i)) return false;
    return std::all_of(touched_.begin(), touched_.end(), [this](const Touched &t) {
        return way(t.path.index).axes[0].smooth() && way(t.path.index).axes[1].smooth();
    });
}

// A move a quarter earlier, and those before it that leave no more rest, or what is left of it after a part
// that goes faster. False if they cannot.
bool Pulling::pull(const OneMove &which) {
    touch(which.whose);
    AxisByQuarters &axis = way(which.whose).axes[which.axis];
    if (axis.moves()[which.move].pulled) return true;
    const auto first = axis.first_to_pull(which.move, spare_);
    if (!first) return false;
    if (first->shorter) axis.shorten(first->move);
    for (int k = first->move + first->shorter; k <= which.move; ++k) axis.pull(k);
    sweep_anew(which.whose, axis.moves()[first->move].begin, axis.moves()[which.move].end + 1);
    return true;
}

// All moves that change what it sweeps in a step. False if there is none that can.
bool Pulling::pull_around(PathIndex i, int step) {
    if (paths_.at(i).still) return false;
    bool any = false;
    for (const int axis : {choice_.first_axis, 1 - choice_.first_axis}) {
        if (any && choice_.one_axis) break;
        const List<AxisMove> &moves = way(i).axes[axis].moves();
        for (int k = 0; k < moves.size(); ++k) {
            const bool around =
                moves[k].end >= begin_of(step) - 1 && moves[k].begin <= begin_of(step) + quarters + 1;
            if (around && !moves[k].pulled) any |= pull({i, axis, k});
        }
    }
    return any;
}

void Pulling::touch(PathIndex i) {
    const auto same = [i](const Touched &t) { return t.path.index == i; };
    if (std::none_of(touched_.begin(), touched_.end(), same))
        touched_.push_back({paths_.save(i), way(i), paths_.steps(), 0});
}

void Pulling::sweep_anew(PathIndex i, int first_quarter, int last_quarter) {
    const WayByQuarters &way = this->way(i);
    const int first = std::max(0, (first_quarter - 1) / quarters - 1);
    const int last = std::min(paths_.steps(), (last_quarter + 2) / quarters);
    for (int step = first; step <= last; ++step) {
        const Cell near = way.nearest(middle_of(step));
        Angles at[quarters + 1];
        for (int k = 0; k <= quarters; ++k) at[k] = way.sent(begin_of(step) + k);
        paths_.sweep_otherwise(i, step, near, at);
    }
    Touched &t = touched(i);
    t.first = std::min(t.first, first);
    t.last = std::max(t.last, last);
    if (!open_.contains(i)) open_.push_back(i);
}

// One from all bodies at rest, and from its neighbours, which are pulled where it meets them.
bool Pulling::part(PathIndex i) {
    for (int step = touched(i).first; step <= touched(i).last; ++step)
        if (!paths_.clear(i, step)) return pull_around(i, step);
    for (const PathIndex j : paths_.at(i).neighbours)
        for (int step = touched(i).first; step <= touched(i).last; ++step)
            while (paths_.meet(i, j, step)) {
                if (choice_.own_first && pull_around(i, step)) return true;
                if (!pull_around(j, step)) return pull_around(i, step);
            }
    return true;
}

void Pulling::end_attempt(bool keep) {
    open_.clear();
    for (Touched &t : touched_) {
        const PathIndex i = t.path.index;
        if (keep) {
            way(i).axes[0].take_marks_off();
            way(i).axes[1].take_marks_off();
            changed_.push_back(i);
        } else {
            ways_[i] = std::move(t.way);
            paths_.restore(std::move(t.path));
        }
    }
    touched_.clear();
}

} // namespace

EarlierByQuarters earlier_by_quarters(PathSet &paths, const Enough &enough) {
    if (paths.heeds_lateness()) return {0, List<OwnKnots, PathIndex>(paths.size())};
    return Pulling(paths, enough).run();
}

} // namespace fl::planning
