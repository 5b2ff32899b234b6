#include "fiberloom/twin/neighbours.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace fl::twin {
namespace {

constexpr double contact_mm_per_N = 0.001; // two tubes of arm size, order of magnitude (assumed)
constexpr double step_share = 0.6;         // of a Newton step, shared by the places: a force follows in 3 ms
constexpr double settled_N = 1e-6;         // a force that would change by less has come to rest
constexpr double let_go_N = 1e-3;          // and one below this, between arms apart, is over
constexpr double metres = 1e-3;

Vec2 minus(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
double cross(Vec2 a, Vec2 b) { return a.x * b.y - a.y * b.x; }

// Away from the other body; where centre lines meet or cross, any direction that both agree on.
Vec2 away(Vec2 from, Vec2 to, double distance, bool first) {
    if (distance > 1e-9) return {(to.x - from.x) / distance, (to.y - from.y) / distance};
    return {first ? 1.0 : -1.0, 0.0};
}

Closest turned(const Closest &c) {
    return {c.on_second, c.on_first, c.along_second, c.along_first, c.distance_mm};
}

Vec2 follow(Vec2 before_N, Vec2 aim_N, double share) {
    const Vec2 step_N = minus(aim_N, before_N);
    if (std::hypot(step_N.x, step_N.y) < settled_N) return before_N;
    return {before_N.x + share * step_N.x, before_N.y + share * step_N.y};
}

// A pair that would end such a slice is looked at by its poses, where slices are longer than to the next
// look.
constexpr uint64_t slice_of_exact_looks = 32;
constexpr uint32_t never = UINT32_MAX;
constexpr double most_free_ticks = 1e9; // Near keeps 32 bits of a tick
constexpr double um_per_mm = 1e3;

// Whole micrometres of travels, modulo 2^32 of them: differences of up to two kilometres are right. floor()
// and ceil() of the baseline are calls of a library.
uint32_t um_below(double travels_mm) {
    const double um = travels_mm * um_per_mm;
    const auto whole = static_cast<int64_t>(um);
    return static_cast<uint32_t>(whole - static_cast<int64_t>(static_cast<double>(whole) > um));
}
uint32_t um_above(double travels_mm) {
    const double um = travels_mm * um_per_mm;
    const auto whole = static_cast<int64_t>(um);
    return static_cast<uint32_t>(whole + static_cast<int64_t>(static_cast<double>(whole) < um));
}

// The last sync point after `tick` that is not later than the first after these ticks, in which two cannot
// touch.
uint64_t sync_after(uint64_t tick, uint64_t free_ticks) {
    return (tick + std::max(free_ticks, sync_ticks)) & ~(sync_ticks - 1);
}

} // namespace

Neighbours::Neighbours(std::vector<Arm> arms, std::vector<Obstacle> obstacles, Body body,
                       const std::vector<Give> &gives, double bound_scale)
    : arms_(std::move(arms)), obstacles_(std::move(obstacles)), body_(body), scale_(bound_scale),
      levers_mm_(arms_.size()), next_look_(arms_.size(), 0), next_exact_(arms_.size(), 0) {
    for (const Give &g : gives)
        compliances_.push_back({{g.compliance_rad_per_Nm[0], g.compliance_rad_per_Nm[1]}});
    compliances_.shrink_to_fit();
    for (size_t i = 0; i < arms_.size(); ++i) allow(i, gives[i]);
    find_neighbours();
}

double Neighbours::reach_mm(size_t i) const { return arms_[i].l_alpha_mm + body_.to_mm + body_.radius_mm; }

// The highest limit and the shortest time constant of all bound each of them. Tells whether it changes them.
bool Neighbours::allow_speed(const SpeedBound &speed) {
    constexpr double spare = 1.01; // for the plant's own steps
    const double limit_rad = spare * scale_ * speed.limit_rad_s * tick_s;
    const double decay_ticks = speed.time_constant_s / tick_s;
    if (limit_rad <= limit_rad_ && decay_ticks >= decay_ticks_) return false;
    limit_rad_ = std::max(limit_rad_, limit_rad);
    decay_ticks_ = std::min(decay_ticks_, decay_ticks);
    return true;
}

// A motor at w0 turns by (t - T) limit + T w0 at most, T = tau (1 - exp(-t/tau)).
void Neighbours::find_reaches() {
    for (size_t k = 0; k < Reaches::count; ++k) {
        const double t = Reaches::ticks[k], coasting = decay_ticks_ * -std::expm1(-t / decay_ticks_);
        reaches_.from_rest_rad[k] = limit_rad_ * (t - coasting);
        reaches_.coasting_ticks[k] = scale_ * coasting;
    }
}

// From the axes of an arm to its farthest point.
Neighbours::Levers Neighbours::longest_mm(size_t i) const {
    const double beta_mm = std::max(std::abs(body_.from_mm), std::abs(body_.to_mm));
    return {arms_[i].l_alpha_mm + beta_mm, beta_mm};
}

bool Neighbours::allow_loose(size_t i, Angles loose) {
    const Levers longest = longest_mm(i);
    const double loose_mm = loose.alpha_rad * longest.alpha + loose.beta_rad * longest.beta;
    const bool wider = loose_mm > loose_mm_;
    loose_mm_ = std::max(loose_mm_, loose_mm);
    return wider;
}

bool Neighbours::allow(size_t i, const Give &give) {
    const Levers longest = longest_mm(i);
    Levers &levers = levers_mm_[i];
    levers.alpha = std::max(levers.alpha, give.output_per_motor[0] * longest.alpha);
    levers.beta = std::max(levers.beta, give.output_per_motor[1] * longest.beta);
    bool wider = false;
    for (const SpeedBound &speed : give.speed)
        if (allow_speed(speed)) wider = true;
    if (wider) find_reaches();
    return wider;
}

void Neighbours::add_near(size_t number) {
    constexpr uint32_t most = (1U << Near::number_bits) - 1;
    if (number > most) throw std::invalid_argument("arms and obstacles: a million at most");
    near_.push_back({0, 0, 1, static_cast<uint32_t>(number) & most, 0});
}

void Neighbours::find_neighbours() {
    const auto apart = [](Vec2 a, Vec2 b) { return std::hypot(a.x - b.x, a.y - b.y); };
    first_near_.reserve(arms_.size() + 1);
    for (size_t i = 0; i < arms_.size(); ++i) {
        first_near_.push_back(static_cast<uint32_t>(near_.size()));
        const Vec2 centre = arms_[i].centre_mm;
        for (size_t j = 0; j < arms_.size(); ++j)
            if (j != i && apart(centre, arms_[j].centre_mm) < reach_mm(i) + reach_mm(j)) add_near(j);
        for (size_t k = 0; k < obstacles_.size(); ++k)
            if (point_segment_distance(centre, obstacles_[k].centre_line_mm) <
                reach_mm(i) + obstacles_[k].radius_mm)
                add_near(arms_.size() + k);
    }
    first_near_.push_back(static_cast<uint32_t>(near_.size()));
    near_.shrink_to_fit();
}

size_t Neighbours::bytes() const {
    const auto held = [](const auto &list) { return list.capacity() * sizeof(list[0]); };
    return held(arms_) + held(obstacles_) + held(compliances_) + held(near_) + held(first_near_) +
           held(levers_mm_) + held(next_look_) + held(next_exact_);
}

uint64_t Neighbours::next_due() const {
    const auto first = std::min_element(next_look_.begin(), next_look_.end());
    return first == next_look_.end() ? UINT64_MAX : *first;
}

Pose Neighbours::pose(size_t i, Angles deflected, Angles rigid) const {
    const double spring_mm =
        std::abs(deflected.alpha_rad - rigid.alpha_rad) * (arms_[i].l_alpha_mm + body_.to_mm) +
        std::abs(deflected.beta_rad - rigid.beta_rad) * body_.to_mm;
    return {deflected, beta_segment(arms_[i], body_.from_mm, body_.to_mm, deflected), spring_mm};
}

// How far the arm gives way along the normal for one newton: levers squared times compliances, Eq. 5a.
double Neighbours::softness_mm_per_N(size_t i, const Pose &pose, const ContactPoint &m) const {
    const double lever_a_m = metres * cross(minus(m.point_mm, arms_[i].centre_mm), m.normal);
    const double lever_b_m =
        metres * cross(minus(m.point_mm, elbow(arms_[i], pose.angles.alpha_rad)), m.normal);
    const double *give = compliances_[i].rad_per_Nm;
    return (lever_a_m * lever_a_m * give[0] + lever_b_m * lever_b_m * give[1]) / metres;
}

// The force at which depth = contact softness times force. A newton more lets both arms give way by their
// softness, which makes a Newton step; a share of it is taken at each sync point, because the normal
// turns as arms bend around each other; several places share it as they share the load. Then J^T F.
void Neighbours::press(Look &look, const Touched &body, const Place &at) const {
    const Closest &c = at.closest;
    const auto same = [&](const Contact &k) { return k.other == body.number && k.place == at.number; };
    const auto old = std::find_if(look.before.begin(), look.before.end(), same);
    const double depth_mm = body.apart_mm - c.distance_mm;
    if (depth_mm <= 0.0 && old == look.before.end()) return;

    const Pose &pose = look.at.poses[look.i];
    const Vec2 normal = away(c.on_second, c.on_first, c.distance_mm, look.i < body.number);
    double give = softness_mm_per_N(look.i, pose, {c.on_first, normal, depth_mm});
    if (body.pose != nullptr)
        give += softness_mm_per_N(body.number, *body.pose, {c.on_second, {-normal.x, -normal.y}, depth_mm});
    const Vec2 before_N = old == look.before.end() ? Vec2{} : old->force_N;
    const double pressed_N = before_N.x * normal.x + before_N.y * normal.y;
    const double aim_N = std::max((depth_mm + give * pressed_N) / (contact_mm_per_N + give), 0.0);
    const Vec2 force_N = follow(before_N, {aim_N * normal.x, aim_N * normal.y}, at.share);
    if (aim_N == 0.0 && std::hypot(force_N.x, force_N.y) < let_go_N) return;

    look.now.push_back({body.number, at.number, force_N});
    const Vec2 axis_b = elbow(arms_[look.i], pose.angles.alpha_rad);
    look.push.torque_Nm[0] += metres * cross(minus(c.on_first, arms_[look.i].centre_mm), force_N);
    look.push.torque_Nm[1] += metres * cross(minus(c.on_first, axis_b), force_N);
}

// Capsules that do not cross touch at ends of their centre lines; side by side, at two of them. Returns
// how far apart the two are, whatever springs back.
double Neighbours::touch(Look &look, const Touched &body) const {
    const Segment &mine = look.at.poses[look.i].line;
    const double distance_mm = segment_distance(mine, body.line);
    const double gap_mm = distance_mm - body.apart_mm;
    if (gap_mm >= 0.0 && !in_touch(look.before, body.number)) {
        // the same bits from both sides
        return gap_mm - (body.spring_mm + look.at.poses[look.i].spring_mm) - loose_mm(body.number);
    }
    const Closest places[] = {closest_point(mine.a, body.line), closest_point(mine.b, body.line),
                              turned(closest_point(body.line.a, mine)),
                              turned(closest_point(body.line.b, mine)), closest_points(mine, body.line)};
    const int ends = 4, count = distance_mm == 0.0 ? 5 : ends;
    const auto deep = [&](const Closest &c) { return c.distance_mm < body.apart_mm; };
    const auto touching = std::count_if(places, places + count, deep);
    const double share = step_share / static_cast<double>(std::max<std::ptrdiff_t>(touching, 1));
    for (int place = 0; place < count; ++place) press(look, body, {place, share, places[place]});
    return 0.0;
}

Neighbours::Touched Neighbours::body(uint32_t number, const std::vector<Pose> &poses) const {
    if (number < arms_.size()) {
        const Pose &pose = poses[number];
        return {number, pose.line, 2.0 * body_.radius_mm, pose.spring_mm, &pose};
    }
    const Obstacle &o = obstacles_[number - arms_.size()];
    return {number, o.centre_line_mm, body_.radius_mm + o.radius_mm, 0.0, nullptr};
}

double Neighbours::loose_mm(uint32_t other) const {
    return other < arms_.size() ? 2.0 * loose_mm_ : loose_mm_;
}

// How far apart two are at least. Poses are asked for where that may be nothing at the next sync point.
double Neighbours::apart_mm(Look &look, Near &near, double travelled_mm) const {
    if (near.exact == 0)
        return static_cast<double>(static_cast<int32_t>(near.meet_um - um_above(travelled_mm))) / um_per_mm;
    const double apart_mm = touch(look, body(static_cast<uint32_t>(near.number), look.at.poses));
    near.meet_um = um_below(apart_mm + travelled_mm);
    near.set_worth(0.5 * apart_mm);
    return apart_mm;
}

void Neighbours::add_mover(Movers &movers, size_t i, const Travel &now) const {
    if (now.speed_mm < 0.0) {
        movers.pushed_mm += pushed_mm(i);
    } else {
        movers.lever_mm += levers_mm_[i].alpha + levers_mm_[i].beta;
        movers.speed_mm += now.speed_mm;
    }
}

double Neighbours::bound_mm(size_t i, const Travel &now, uint64_t ticks) const {
    Movers mover;
    add_mover(mover, i, now);
    const auto reach = std::find_if(Reaches::ticks.begin(), Reaches::ticks.end(),
                                    [ticks](double t) { return t >= static_cast<double>(ticks); });
    if (reach == Reaches::ticks.end()) throw std::invalid_argument("bound: 256 ticks at most");
    return bound_mm(mover, static_cast<size_t>(reach - Reaches::ticks.begin())) + loose_mm_;
}

// For how long they come no further than that: bounds grow.
uint64_t Neighbours::free_ticks(const Movers &movers, double apart_mm) const {
    size_t within = 0;
    for (size_t k = 0; k < Reaches::count; ++k) within += bound_mm(movers, k) <= apart_mm ? 1 : 0;
    if (within == 0) return 0;
    if (within < Reaches::count) return static_cast<uint64_t>(Reaches::ticks[within - 1]);
    const double left_mm = apart_mm - bound_mm(movers, Reaches::count - 1);
    const double free = left_mm / (limit_rad_ * movers.lever_mm + movers.pushed_mm);
    return longest_ticks + static_cast<uint64_t>(static_cast<int64_t>(std::min(free, most_free_ticks)));
}

void Neighbours::plan_look(const Look &look, Near &near, double apart_mm) const {
    Movers movers;
    add_mover(movers, look.i, look.at.travels[look.i]);
    if (near.number < arms_.size()) add_mover(movers, near.number, look.at.travels[near.number]);
    const uint64_t free = free_ticks(movers, apart_mm);
    const bool touching = in_touch(look.now, static_cast<uint32_t>(near.number));
    const uint64_t soon = look.at.ahead == 0 ? sync_ticks : slice_of_exact_looks;
    const bool close = touching || free < soon || apart_mm < near.worth_mm();
    near.exact = close ? 1 : 0;
    near.next_look = static_cast<uint32_t>(touching ? look.at.tick + 1 : sync_after(look.at.tick, free));
}

void Neighbours::plan_first_looks(const std::vector<Pose> &poses) {
    const std::vector<Contact> none;
    const std::vector<Travel> at_rest(arms_.size());
    for (size_t i = 0; i < arms_.size(); ++i) {
        Look look{i, {poses, at_rest, 0, 0}, none, {}, {}};
        for (Near &near : near(i)) {
            const Touched other = body(static_cast<uint32_t>(near.number), poses);
            if (segment_distance(poses[i].line, other.line) < other.apart_mm) continue;
            plan_look(look, near, apart_mm(look, near, 0.0));
        }
    }
}

void Neighbours::disturb(size_t i, uint64_t tick) {
    for (const Near &near : near(i)) {
        hasten(i, near.number, tick);
        if (near.number < arms_.size()) hasten(near.number, i, tick);
    }
}

// One look of arm i.
void Neighbours::hasten(size_t i, size_t other, uint64_t tick) {
    const auto pairs = near(i);
    const auto found =
        std::find_if(pairs.begin(), pairs.end(), [other](const Near &n) { return n.number == other; });
    const uint64_t first = next_look_[i], due = first + found->ticks_after(first);
    found->exact = 1;
    found->next_look = static_cast<uint32_t>(std::min(due, tick));
    next_look_[i] = std::min(first, tick);
    next_exact_[i] = std::min({next_exact_[i], due, tick});
}

Push Neighbours::push(size_t i, const Moment &at, std::vector<Contact> &contacts) {
    if (at.tick + at.ahead < next_look_[i]) return {};
    Look look{i, at, contacts, {}, {}};
    // ticks of looks are counted from the first of all pairs of this positioner
    const uint64_t first = next_look_[i];
    const auto passed = static_cast<uint32_t>(at.tick + at.ahead - first);
    uint32_t next = never, exact = never;
    for (Near &near : near(i)) {
        if (near.ticks_after(first) <= passed) {
            const double other_mm = near.number < arms_.size() ? at.travels[near.number].way_mm : 0.0;
            plan_look(look, near, apart_mm(look, near, at.travels[i].way_mm + other_mm));
        }
        const uint32_t after = near.ticks_after(first);
        next = std::min(next, after);
        exact = std::min(exact, after | (near.exact - 1U)); // never, unless by poses
    }
    next_look_[i] = next == never ? UINT64_MAX : first + next;
    next_exact_[i] = exact == never ? UINT64_MAX : first + exact;
    contacts = std::move(look.now);
    return look.push;
}

} // namespace fl::twin
