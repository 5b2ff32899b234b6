#include "fiberloom/lateness.hpp"
#include "verify/track.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <queue>
#include <utility>

namespace fl::planning {
namespace {

constexpr double lateness_true_s = 1e-3; // the lateness that is borne is found to within this
constexpr double depth_true_mm = 1e-2;
constexpr double still_mm = 1e-7;         // arms that move less in a cell are at rest there
constexpr int kept_levels = 9;            // halvings of the plan whose middles are kept
constexpr int most_depth_looks = 200'000; // what is found by then is told

// An interval of the plan that comes from halving it.
struct Span {
    int level = 0;
    std::int64_t index = 0;
    Span half(int which) const { return {level + 1, 2 * index + which}; }
};

// One positioner in such an interval: its parts in the middle, and how far their points get from there.
struct Posture {
    std::vector<Place> parts;
    double way_mm = 0.0;
};

double body_gap_mm(const std::vector<Place> &mine, const std::vector<Place> &theirs) {
    double least = std::numeric_limits<double>::infinity();
    for (const Place &p : mine)
        for (const Place &q : theirs) least = std::min(least, part_gap_mm(p, q, segment_distance));
    return least;
}

// One positioner over the whole plan; places in long intervals are found once.
class LateTrack {
  public:
    LateTrack(const Track &track, double end_s) : track_(track), end_s_(end_s) {
        for (int level = 0; level < kept_levels; ++level) kept_.emplace_back(std::size_t{1} << level);
    }

    double begin_s(Span span) const { return end_s_ * static_cast<double>(span.index) * size(span); }
    double end_s(Span span) const { return end_s_ * static_cast<double>(span.index + 1) * size(span); }
    std::vector<Place> parts(double time_s) const {
        std::vector<Place> out;
        for (int part = 0; part < track_.parts(); ++part) out.push_back(track_.place(part, time_s));
        return out;
    }

    // Good until the next call.
    const Posture &posture(Span span) {
        if (span.level >= kept_levels) return last_ = look(span);
        auto &kept = kept_[span.level][span.index];
        if (!kept) kept = std::make_unique<Posture>(look(span));
        return *kept;
    }

  private:
    static double size(Span span) { return std::ldexp(1.0, -span.level); }
    Posture look(Span span) const {
        const double from = begin_s(span), to = end_s(span), middle = 0.5 * (from + to);
        const double before = track_.travelled_mm(from), here = track_.travelled_mm(middle),
                     after = track_.travelled_mm(to);
        return {parts(middle), std::max(here - before, after - here)};
    }

    const Track &track_;
    double end_s_;
    std::vector<std::vector<std::unique_ptr<Posture>>> kept_;
    Posture last_;
};

// Moments t of one that is late and s of another one, and the bounds of their gap. `key` orders the search.
struct Cell {
    Span late, other;
    double least_s = 0.0; // s - t, at least and at most
    double most_s = 0.0;
    double gap_mm = 0.0; // in the middle
    double way_late_mm = 0.0, way_other_mm = 0.0;
    double key = 0.0;
    double lower_mm() const { return gap_mm - way_late_mm - way_other_mm; }
    double upper_mm() const { return gap_mm + way_late_mm + way_other_mm; }
    bool at_rest() const { return way_late_mm + way_other_mm < still_mm; }
};

struct Later {
    bool operator()(const Cell &p, const Cell &q) const {
        const std::array a{p.key, static_cast<double>(p.late.index), static_cast<double>(p.other.index)};
        const std::array b{q.key, static_cast<double>(q.late.index), static_cast<double>(q.other.index)};
        return a > b;
    }
};

using Queue = std::priority_queue<Cell, std::vector<Cell>, Later>;

// Two moments of the plan at which the two are.
struct Moment {
    double late_at_s = 0.0, other_at_s = 0.0;
    double lateness_s() const { return other_at_s - late_at_s; }
};

// One that is late, and another one.
class LateEncounter {
  public:
    // radii_mm: of their largest parts together.
    LateEncounter(LateTrack &late, LateTrack &other, double radii_mm, double asked_s)
        : late_(late), other_(other), radii_mm_(radii_mm), asked_s_(asked_s) {}

    // Whether they touch at some lateness.
    bool touch() {
        find_least();
        return std::isfinite(found_s_);
    }
    // @pre they do.
    LatePair told(int late, int other) {
        if (found_s_ <= asked_s_) find_deepest();
        return {late, other, borne_s_, at_.late_at_s, at_.other_at_s, depth_mm_};
    }

  private:
    Cell cell(Span late, Span other) const {
        Cell c{late, other};
        c.least_s = std::max(0.0, other_.begin_s(other) - late_.end_s(late));
        c.most_s = other_.end_s(other) - late_.begin_s(late);
        const Posture &p = late_.posture(late), &q = other_.posture(other);
        c.gap_mm = body_gap_mm(p.parts, q.parts);
        c.way_late_mm = p.way_mm;
        c.way_other_mm = q.way_mm;
        return c;
    }

    // The halves of a cell: of the one that travels farther in it.
    std::array<Cell, 2> halves(const Cell &c) const {
        if (c.way_late_mm >= c.way_other_mm)
            return {cell(c.late.half(0), c.other), cell(c.late.half(1), c.other)};
        return {cell(c.late, c.other.half(0)), cell(c.late, c.other.half(1))};
    }

    // A moment of a cell whose lateness is in a range that the cell has part in: as near to the middle as can
    // be on the way to the corner that is the least late, or the latest.
    Moment moment(const Cell &c, double least_s, double most_s) const {
        const double t0 = late_.begin_s(c.late), t1 = late_.end_s(c.late);
        const double s0 = other_.begin_s(c.other), s1 = other_.end_s(c.other);
        const Moment middle{0.5 * (t0 + t1), 0.5 * (s0 + s1)};
        const double is = middle.lateness_s(), wanted = std::clamp(is, least_s, std::max(least_s, most_s));
        const Moment corner = wanted > is ? Moment{t0, s1} : Moment{t1, s0};
        const double room = corner.lateness_s() - is;
        const double part = room == 0.0 ? 0.0 : std::clamp((wanted - is) / room, 0.0, 1.0);
        return {middle.late_at_s + part * (corner.late_at_s - middle.late_at_s),
                middle.other_at_s + part * (corner.other_at_s - middle.other_at_s)};
    }

    double gap_mm(Moment at) const {
        return body_gap_mm(late_.parts(at.late_at_s), other_.parts(at.other_at_s));
    }

    // --- the least lateness at which they touch: cells in the order of theirs ---

    void touches_at(Moment at) {
        if (at.lateness_s() >= found_s_) return;
        found_s_ = std::max(0.0, at.lateness_s());
        at_ = at;
    }

    // Whether no touch in a cell would be worth being found.
    bool late_enough(const Cell &c) const {
        const bool decided = found_s_ <= asked_s_ || c.least_s > asked_s_;
        return c.least_s >= found_s_ || (decided && c.least_s >= found_s_ - lateness_true_s);
    }

    void add_least(Queue &queue, Cell c) {
        if (c.most_s < 0.0 || c.lower_mm() >= -touching_mm) return;
        // what cannot be shown to be apart touches
        if (c.upper_mm() < -touching_mm || c.at_rest()) return touches_at(moment(c, c.least_s, c.least_s));
        if (c.gap_mm < -touching_mm) {
            const Moment middle = moment(c, -end_of_time, end_of_time);
            if (middle.lateness_s() >= 0.0) touches_at(middle);
        }
        c.key = c.least_s;
        queue.push(c);
    }

    void find_least() {
        Queue queue;
        add_least(queue, cell({}, {}));
        while (!queue.empty() && !late_enough(queue.top())) {
            const Cell c = queue.top();
            queue.pop();
            for (const Cell &half : halves(c)) add_least(queue, half);
        }
        borne_s_ = queue.empty() ? found_s_ : std::min(found_s_, queue.top().least_s);
    }

    // --- the deepest touch that is no later than was asked for: cells in the order of what they may be ---

    void add_deepest(Queue &queue, Cell c) {
        if (c.most_s < 0.0 || c.least_s > asked_s_) return;
        const Moment at = moment(c, 0.0, asked_s_);
        if (const double depth = -gap_mm(at); depth > depth_mm_) {
            depth_mm_ = depth;
            at_ = at;
        }
        c.key = std::max(c.lower_mm(), -radii_mm_);
        if (!c.at_rest()) queue.push(c);
    }

    void find_deepest() {
        Queue queue;
        depth_mm_ = std::max(0.0, -gap_mm(at_));
        add_deepest(queue, cell({}, {}));
        for (int looks = 0; looks < most_depth_looks && !queue.empty(); ++looks) {
            const Cell c = queue.top();
            queue.pop();
            if (-c.key <= depth_mm_ + depth_true_mm) break;
            for (const Cell &half : halves(c)) add_deepest(queue, half);
        }
    }

    static constexpr double end_of_time = 1e9;

    LateTrack &late_, &other_;
    double radii_mm_, asked_s_;
    double found_s_ = std::numeric_limits<double>::infinity(); // a lateness at which they touch
    double borne_s_ = 0.0;                                     // none below this does
    Moment at_;
    double depth_mm_ = 0.0;
};

class LateVerifier {
  public:
    LateVerifier(const Bodies &bodies, const std::vector<Motion> &motions, double late_s) : late_s_(late_s) {
        double end_s = 0.0;
        for (int i = 0; i < count(motions); ++i) {
            tracks_.emplace_back(bodies.arms[i], bodies.parts[i], motions[i]);
            end_s = std::max(end_s, tracks_.back().end_s());
        }
        for (const Track &track : tracks_) late_tracks_.emplace_back(track, end_s);
    }

    Lateness run() {
        for (int i = 0; i < count(tracks_); ++i)
            for (int j = 0; j < count(tracks_); ++j)
                if (i != j && can_meet(i, j)) look(i, j);
        return std::move(out_);
    }

  private:
    bool can_meet(int i, int j) const {
        const Track &p = tracks_[i], &q = tracks_[j];
        const Vec2 c = p.centre_mm(), d = q.centre_mm();
        return p.moves() && q.moves() &&
               std::hypot(c.x - d.x, c.y - d.y) - p.reach_mm() - q.reach_mm() - radii_mm(i, j) <= 0.0;
    }

    double radii_mm(int i, int j) const { return tracks_[i].radius_mm() + tracks_[j].radius_mm(); }

    void look(int late, int other) {
        ++out_.looked_at;
        LateEncounter pair(late_tracks_[late], late_tracks_[other], radii_mm(late, other), late_s_);
        if (pair.touch()) out_.pairs.push_back(pair.told(late, other));
    }

    double late_s_;
    std::vector<Track> tracks_;
    std::vector<LateTrack> late_tracks_;
    Lateness out_;
};

} // namespace

Lateness lateness(const Bodies &bodies, const std::vector<Motion> &motions, double late_s) {
    return LateVerifier(bodies, motions, late_s).run();
}

} // namespace fl::planning
