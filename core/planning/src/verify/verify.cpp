#include "fiberloom/verify.hpp"
#include "verify/separation.hpp"
#include "verify/track.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace fl::planning {
namespace {

constexpr double gap_true_mm = 1e-4; // the smallest gap is found to within this
constexpr int deepest = 60;          // halvings; the bound settles long before

// The gap of two bodies over time.
class Encounter {
  public:
    Encounter(Two bodies, double wanted_mm) : bodies_(bodies), wanted_mm_(wanted_mm) {}

    // The smallest gap, if it is below `wanted_mm` or negative; otherwise some gap above both.
    Gap closest() {
        const Moment first = look(0.0), last = look(bodies_.end_s());
        descend(first, last, 0);
        return best_;
    }

  private:
    struct Moment {
        double time_s, gap_mm, travelled_mm;
    };

    Moment look(double time_s) {
        const double gap = bodies_.gap_mm(time_s, segment_distance);
        if (gap < best_.gap_mm) best_ = {gap, time_s, -1, -1};
        return {time_s, gap, bodies_.travelled_mm(time_s)};
    }

    // Above this a bound needs no closer look.
    double enough_mm() const {
        if (best_.gap_mm < -touching_mm) return best_.gap_mm - gap_true_mm; // a collision: only how deep
        return std::max(-touching_mm, std::min(wanted_mm_, best_.gap_mm) - gap_true_mm);
    }

    void descend(const Moment &from, const Moment &to, int depth) {
        const double way = to.travelled_mm - from.travelled_mm;
        // lines that cross cannot be nearer: nothing is gained in an interval where they stay so
        const double bound = std::max(0.5 * (from.gap_mm + to.gap_mm - way), -bodies_.radii_mm());
        if (bound >= enough_mm()) return;
        if (depth == deepest) { // cannot be shown to be free: it is not
            if (bound < best_.gap_mm) best_ = {bound, from.time_s, -1, -1};
            return;
        }
        const Moment middle = look(0.5 * (from.time_s + to.time_s));
        descend(from, middle, depth + 1);
        descend(middle, to, depth + 1);
    }

    Two bodies_;
    double wanted_mm_;
    Gap best_;
};

// Where an axis is at a moment; where it begins and ends before and after its motion.
double axis_at(const Motion &m, double Angles::*axis, double time_s) {
    int k = 1;
    while (k < count(m.time_s) && m.time_s[k] < time_s) ++k;
    if (k >= count(m.time_s)) return m.angles.back().*axis;
    const double part = std::max(0.0, (time_s - m.time_s[k - 1]) / (m.time_s[k] - m.time_s[k - 1]));
    return m.angles[k - 1].*axis + part * (m.angles[k].*axis - m.angles[k - 1].*axis);
}

// Of one positioner, where it has its own.
double own(const std::vector<double> &rows, int i, double common) { return rows.empty() ? common : rows[i]; }

Fault at_rest(Fault fault) { return fault == Fault::robots ? Fault::contact : Fault::obstacle_contact; }

class Verifier {
  public:
    Verifier(const Bodies &bodies, const std::vector<Motion> &motions, const Rules &rules)
        : bodies_(bodies), motions_(motions), rules_(rules) {}

    Verification run() {
        for (int i = 0; i < count(motions_); ++i)
            if (!check_points(i)) return out_; // nothing else has a meaning
        for (int i = 0; i < count(motions_); ++i) {
            tracks_.emplace_back(bodies_.arms[i], bodies_.parts[i], motions_[i]);
            check_axes(i);
            check_ends(i);
        }
        check_pairs();
        check_obstacles();
        return out_;
    }

  private:
    void report(Fault fault, int robot, int other, double time_s, double depth) {
        out_.violations.push_back({fault, robot, other, time_s, depth});
    }

    bool check_points(int i);
    void check_axes(int i);
    void check_axis(int i, double Angles::*axis, double low, double high);
    void check_speeds(int i, const std::vector<double> &speeds);
    void check_ends(int i);
    void check_end(Fault fault, int i, Angles is, Angles should, double time_s);
    void check_approach(int i);
    void check_said(const Approach &said);
    double off_last_leg(const Motion &m, double Angles::*axis, double side, const LastLeg &leg) const;
    void check_pairs();
    void check_pair(int i, int j);
    void check_obstacles();
    bool separates(int i, int other, Separation pair, Fault fault, Gap &smallest);
    void note(Gap gap, int i, int other, Fault fault, bool moving, Gap &smallest);

    const Bodies &bodies_;
    const std::vector<Motion> &motions_;
    const Rules &rules_;
    std::vector<Track> tracks_;
    Verification out_;
};

bool Verifier::check_points(int i) {
    const bool good = sound(motions_[i]);
    if (!good) report(Fault::points, i, -1, 0.0, 0.0);
    return good;
}

// The largest breach of each kind only: one line per positioner and rule.
void Verifier::check_speeds(int i, const std::vector<double> &speeds) {
    const auto &t = motions_[i].time_s;
    const double top_speed = own(rules_.own_speed_rad_s, i, rules_.speed_rad_s);
    const double top_acceleration = own(rules_.own_acceleration_rad_s2, i, rules_.acceleration_rad_s2);
    Violation fast{Fault::speed, i}, sharp{Fault::acceleration, i};
    const int last = count(speeds);
    for (int k = 0; k <= last; ++k) {
        // before the first and after the last point the axis rests, for as long as its neighbour segment
        const double before = k == 0 ? 0.0 : speeds[k - 1], after = k == last ? 0.0 : speeds[k];
        const double d0 = k == 0 ? t[1] - t[0] : t[k] - t[k - 1], d1 = k == last ? d0 : t[k + 1] - t[k];
        const double jump = std::abs(after - before), acceleration = jump / (0.5 * (d0 + d1));
        out_.top_jump_rad_s = std::max(out_.top_jump_rad_s, jump);
        out_.top_speed_rad_s = std::max(out_.top_speed_rad_s, std::abs(after));
        out_.top_acceleration_rad_s2 = std::max(out_.top_acceleration_rad_s2, acceleration);
        if (std::abs(after) - top_speed > fast.depth)
            fast = {Fault::speed, i, -1, t[k], std::abs(after) - top_speed};
        if (acceleration - top_acceleration > sharp.depth)
            sharp = {Fault::acceleration, i, -1, t[k], acceleration - top_acceleration};
    }
    for (const Violation &v : {fast, sharp})
        if (v.depth > 0.0) out_.violations.push_back(v);
}

void Verifier::check_axis(int i, double Angles::*axis, double low, double high) {
    const Motion &m = motions_[i];
    // one that is beyond a limit may come back, but not go farther out
    low = std::min(low, m.angles.front().*axis) - rules_.rounding_rad;
    high = std::max(high, m.angles.front().*axis) + rules_.rounding_rad;
    std::vector<double> speeds;
    for (int k = 0; k < count(m.angles); ++k) {
        const double here = m.angles[k].*axis, beyond = std::max(low - here, here - high);
        if (beyond > 0.0) report(Fault::travel, i, -1, m.time_s[k], beyond);
        if (k > 0) speeds.push_back((here - m.angles[k - 1].*axis) / (m.time_s[k] - m.time_s[k - 1]));
    }
    if (!speeds.empty()) check_speeds(i, speeds);
}

void Verifier::check_axes(int i) {
    const Limits &t = travel_of(rules_, i);
    check_axis(i, &Angles::alpha_rad, t.alpha_min_rad, t.alpha_max_rad);
    check_axis(i, &Angles::beta_rad, t.beta_min_rad, t.beta_max_rad);
}

void Verifier::check_end(Fault fault, int i, Angles is, Angles should, double time_s) {
    const double off =
        std::max(std::abs(is.alpha_rad - should.alpha_rad), std::abs(is.beta_rad - should.beta_rad));
    if (off > rules_.rounding_rad) report(fault, i, -1, time_s, off);
}

void Verifier::check_ends(int i) {
    const Motion &m = motions_[i];
    if (!rules_.start.empty()) check_end(Fault::start, i, m.angles.front(), rules_.start[i], 0.0);
    if (!rules_.goal.empty() && rules_.arrives[i] != 0)
        check_end(Fault::goal, i, m.angles.back(), rules_.goal[i], m.time_s.back());
    const auto said = std::find_if(rules_.approaches.begin(), rules_.approaches.end(),
                                   [i](const Approach &a) { return a.robot == i; });
    if (said != rules_.approaches.end())
        check_said(*said);
    else if (!rules_.approach_rad.empty() && tracks_[i].moves())
        check_approach(i);
}

// From the end back: as long as both axes fall, they must have come from approach_rad above; rise, from
// below.
void Verifier::check_approach(int i) {
    const auto &p = motions_[i].angles;
    const auto fallen = [&](int from, int to) { // the axis that falls less
        return std::min(rules_.sides.alpha * (p[from].alpha_rad - p[to].alpha_rad),
                        rules_.sides.beta * (p[from].beta_rad - p[to].beta_rad));
    };
    const int last = count(p) - 1;
    int k = last;
    while (k > 0 && fallen(k - 1, k) >= 0.0) --k;
    const double height = fallen(k, last);
    const double missing = rules_.approach_rad[i] - height;
    if (missing > 2.0 * rules_.rounding_rad)
        report(Fault::approach, i, -1, motions_[i].time_s.back(), missing);
}

// By how much an axis is not where its last leg shall begin, goes away from its goal afterwards, or is not
// there in time.
double Verifier::off_last_leg(const Motion &m, double Angles::*axis, double side, const LastLeg &leg) const {
    const double rounding_s = 1e-9, height = side * leg.height_rad;
    const bool sound = height >= 0.0 && height < 1e9 && leg.begin_s >= 0.0 && leg.begin_s < leg.end_s &&
                       leg.end_s <= m.time_s.back() + rounding_s;
    if (!sound) return std::numeric_limits<double>::infinity();
    const double goal = m.angles.back().*axis;
    double low = axis_at(m, axis, leg.begin_s);
    double off = std::abs(low - goal - leg.height_rad);
    for (int k = 0; k < count(m.angles); ++k) {
        if (m.time_s[k] <= leg.begin_s) continue;
        off = std::max(off, side * (m.angles[k].*axis - low));
        low = m.angles[k].*axis;
    }
    return std::max(off, std::abs(axis_at(m, axis, leg.end_s) - goal));
}

// One that has told how it comes does so, from no less than what is asked for, whatever it did before.
void Verifier::check_said(const Approach &said) {
    const Motion &m = motions_[said.robot];
    const auto [alpha, beta] = rules_.sides;
    double off = std::max(off_last_leg(m, &Angles::alpha_rad, alpha, said.alpha),
                          off_last_leg(m, &Angles::beta_rad, beta, said.beta));
    if (!rules_.approach_rad.empty())
        off = std::max(off, rules_.approach_rad[said.robot] -
                                std::min(alpha * said.alpha.height_rad, beta * said.beta.height_rad));
    if (!(off <= 2.0 * rules_.rounding_rad)) report(Fault::approach, said.robot, -1, m.time_s.back(), off);
}

void Verifier::note(Gap gap, int i, int other, Fault fault, bool moving, Gap &smallest) {
    gap.robot = i;
    gap.other = other;
    if (gap.gap_mm < smallest.gap_mm) smallest = gap;
    if (gap.gap_mm < -touching_mm) report(moving ? fault : at_rest(fault), i, other, gap.time_s, -gap.gap_mm);
}

// Bodies that overlap at the start and may move apart; false: the usual rule holds for them. What still
// overlaps at the end is told as a contact.
bool Verifier::separates(int i, int other, Separation pair, Fault fault, Gap &smallest) {
    if (!rules_.separating || pair.gap_mm(0.0) >= -touching_mm) return false;
    pair.prove();
    if (pair.smallest_mm() < smallest.gap_mm) smallest = {pair.smallest_mm(), pair.smallest_s(), i, other};
    const bool arms = fault == Fault::robots;
    if (pair.closing_mm() > 0.0)
        report(arms ? Fault::closing : Fault::obstacle_closing, i, other, pair.closing_s(),
               pair.closing_mm());
    if (pair.last_mm() < -touching_mm) report(at_rest(fault), i, other, pair.end_s(), -pair.last_mm());
    return true;
}

void Verifier::check_pair(int i, int j) {
    const Track &p = tracks_[i], &q = tracks_[j];
    const Vec2 c = p.centre_mm(), d = q.centre_mm();
    const Two both{p, &q};
    if (std::hypot(c.x - d.x, c.y - d.y) - p.reach_mm() - q.reach_mm() - both.radii_mm() > 0.0) return;
    if (separates(i, j, Separation(both), Fault::robots, out_.robots)) return;
    const Gap gap = Encounter(both, out_.robots.gap_mm).closest();
    note(gap, i, j, Fault::robots, p.moves() || q.moves(), out_.robots);
}

// Only positioners whose x differ by less than two reaches can meet.
void Verifier::check_pairs() {
    std::vector<std::pair<double, int>> by_x;
    double reach = 0.0;
    for (int i = 0; i < count(tracks_); ++i) {
        by_x.emplace_back(tracks_[i].centre_mm().x, i);
        reach = std::max(reach, tracks_[i].reach_mm() + tracks_[i].radius_mm());
    }
    std::sort(by_x.begin(), by_x.end());
    for (int a = 0; a < count(by_x); ++a)
        for (int b = a + 1; b < count(by_x) && by_x[b].first - by_x[a].first <= 2.0 * reach; ++b)
            check_pair(std::min(by_x[a].second, by_x[b].second), std::max(by_x[a].second, by_x[b].second));
}

void Verifier::check_obstacles() {
    for (int i = 0; i < count(tracks_); ++i)
        for (int k = 0; k < count(bodies_.obstacles); ++k) {
            const Capsule &o = bodies_.obstacles[k];
            const Two both{tracks_[i], nullptr, o};
            const double reach = tracks_[i].reach_mm() + both.radii_mm();
            if (o.owner == i || point_segment_distance(tracks_[i].centre_mm(), o.line) > reach) continue;
            if (separates(i, k, Separation(both), Fault::obstacle, out_.obstacles)) continue;
            const Gap gap = Encounter(both, out_.obstacles.gap_mm).closest();
            note(gap, i, k, Fault::obstacle, tracks_[i].moves(), out_.obstacles);
        }
}

} // namespace

const char *to_string(Fault fault) {
    static constexpr const char *names[] = {
        "robots",       "obstacle", "contact", "obstacle_contact", "points",  "travel",          "speed",
        "acceleration", "start",    "goal",    "approach",         "closing", "obstacle_closing"};
    return names[static_cast<int>(fault)];
}

bool sound(const Motion &motion) {
    const auto &[t, angles] = motion;
    bool good = !t.empty() && t.size() == angles.size() && t.front() == 0.0 && std::isfinite(t.back());
    for (int k = 0; good && k < count(t); ++k)
        good = std::isfinite(angles[k].alpha_rad) && std::isfinite(angles[k].beta_rad) &&
               (k == 0 || t[k - 1] < t[k]);
    return good;
}

Verification verify(const Bodies &bodies, const std::vector<Motion> &motions, const Rules &rules) {
    return Verifier(bodies, motions, rules).run();
}

} // namespace fl::planning
