#include "fiberloom/twin/twin.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "lane_group.hpp"
#include "workers.hpp"

namespace fl::twin {
namespace {

constexpr uint64_t lone_ticks = 32;   // of a slice where nothing meets: what a group needs stays in the cache
constexpr uint64_t bounce_ticks = 80; // what comes back within 40 ms is the same contact
constexpr uint16_t no_index = UINT16_MAX;
constexpr double two_pi = 2.0 * std::numbers::pi;
constexpr double counts_per_turn = 1073741824.0; // 2^30 per output turn on the wire

std::vector<double> flat(const std::vector<Angles> &angles) {
    std::vector<double> out;
    for (const Angles &a : angles) out.insert(out.end(), {a.alpha_rad, a.beta_rad});
    return out;
}

void check_sizes(const TwinSetup &s) {
    const size_t n = s.ids.size();
    if (s.units.size() != 2 * n || s.params.size() != 2 * n || s.start.size() != n || s.arms.size() != n)
        throw std::invalid_argument("ids, arms and start need N rows, units and params 2 N");
    if (s.threads < 1 || s.threads > 256) throw std::invalid_argument("threads: 1 to 256");
    for (uint16_t id : s.ids)
        if (id < 1 || id > 2047) throw std::invalid_argument("positioner ids: 1 to 2047");
}

size_t id_count(const TwinSetup &s) {
    return s.ids.empty() ? 0 : size_t{*std::max_element(s.ids.begin(), s.ids.end())} + 1;
}

FactoryParams::Both params_of_first(const TwinSetup &s) {
    FactoryParams::Both both{};
    if (!s.params.empty()) std::copy_n(s.params.begin(), FL_AXES, both.begin());
    return both;
}

std::vector<Give> gives_of(const Plant &plant) {
    std::vector<Give> gives(plant.axis_count() / 2);
    for (size_t axis = 0; axis < plant.axis_count(); ++axis) {
        Give &g = gives[axis / 2];
        g.compliance_rad_per_Nm[axis % 2] = plant.compliance_rad_per_Nm(axis);
        // the true ratio differs locally from n by the slope of delta, a few tenths at most
        g.output_per_gear[axis % 2] = 1.5 / plant.params(axis).gear_ratio;
        g.speed_limit_rad_s[axis % 2] = g.output_per_gear[axis % 2] * plant.speed_limit_rad_s(axis);
    }
    return gives;
}

// Where a datum search ends the rotor has wound up the gear by 0.5 to 1.5 turns beyond the first touch; the
// rotor's angle tells the rest. tests/twin/faults/test_faults.py searches datums against it.
constexpr double wound_rad = two_pi;

int32_t wire_count(double motor_rad, double gear_ratio) {
    return static_cast<int32_t>(std::lround(motor_rad / (two_pi * gear_ratio) * counts_per_turn));
}

} // namespace

struct Twin::State {
    explicit State(const TwinSetup &s);

    void boot(const TwinSetup &s);
    void run_slice(uint64_t ticks);
    void run_closely(uint64_t ticks);
    void take_turn(size_t group);
    void run_group(size_t group, uint64_t ticks);

    void feel_group(size_t group);
    bool touches(size_t i) const { return felt[i] != 0 && !positioners[i].touch().contacts.empty(); }
    bool in_contact(size_t group) const;
    bool pushes(size_t group);

    void feel_neighbours(size_t i, Outbox &outbox);
    void note_touches(size_t i, Outbox &outbox);
    void apply_torque(size_t i, const Push &push);
    void put_torque(size_t i);
    Angles at_rest(size_t i) const;
    void publish(size_t i);
    void travel(size_t group);
    void show_poses();
    void hear(size_t i, const fl_can_frame_t &frame, int bus);
    bool any_awake() const;
    // Which arms might touch is looked at every 2 ms; the forces of those that do follow every tick.
    bool at_sync() const { return now % sync_ticks == 0; }
    uint64_t slice_ticks() const;
    struct Rows {
        size_t begin, end;
    };
    Rows rows_of(size_t group) const {
        return {group * lane_group_size, std::min((group + 1) * lane_group_size, count)};
    }
    void follow_loads(Rows rows);
    std::vector<Reply> collect();
    void check(size_t i) const {
        if (i >= count) throw std::out_of_range("positioner " + std::to_string(i) + ": no such index");
    }
    // For whom it may be read or changed: its firmware is up to date.
    Positioner &at(size_t i) {
        check(i);
        release(i);
        return positioners[i];
    }
    void release(size_t i) { lane_groups[i / lane_group_size].release(i % lane_group_size, now); }

    Plant plant;
    size_t count;
    const FactoryParams::Both first_params;    // of the first positioner: others tell what differs
    std::unique_ptr<Positioner[]> positioners; // never moved: their ports point back at them
    std::vector<LaneGroup> lane_groups;        // one per group of the plant
    std::vector<PositionerGroup> groups;       // and what its positioners have in common
    std::vector<uint16_t> index_of_id;         // up to the largest; or no_index
    Neighbours neighbours;
    bool feel;
    bool skip_resting;
    bool loaded = false; // something pulls at the arms: it follows them at sync points
    uint64_t now = 0;
    uint64_t begun = 0;           // the slice that runs, in which all have felt their neighbours
    uint64_t slice = 0;           // its ticks
    std::vector<size_t> turns;    // groups of the batch that runs
    std::vector<uint8_t> felt;    // by positioner: it touches something, or has just done so
    std::vector<uint8_t> pushed;  // by positioner: the force on it may change from tick to tick in this slice
    std::vector<uint32_t> scoped; // by group: who has a scope on, a bit each
    std::vector<uint8_t> close;   // by group: its arms touch, so that it waits for its turn tick by tick
    bool quiet = false;           // a sync point has passed with every positioner asleep: time alone goes on
    // where the arms are: as of the last sync point (read), and of the next (written)
    std::vector<Pose> seen, next;
    // how far each has travelled by then (Neighbours::travel_mm), and where its gears were
    std::vector<double> travels_mm, next_travels_mm, gears_rad;
    Gravity gravity;
    Workers workers;
};

Twin::State::State(const TwinSetup &s)
    : plant((check_sizes(s), s.units), flat(s.start), s.seed, s.kernel.c_str(), s.substeps),
      count(s.ids.size()), first_params(params_of_first(s)),
      positioners(std::make_unique<Positioner[]>(count)), lane_groups(plant.group_count()),
      groups(plant.group_count()), index_of_id(id_count(s), no_index),
      neighbours(s.arms, s.obstacles, s.body, gives_of(plant)), feel(s.neighbours),
      skip_resting(s.skip_resting), felt(s.ids.size()), pushed(s.ids.size()), scoped(plant.group_count()),
      close(plant.group_count()), seen(s.ids.size()), next(s.ids.size()), travels_mm(s.ids.size()),
      next_travels_mm(s.ids.size()), gears_rad(plant.group_count() * lane_count),
      workers(s.threads, [this](size_t turn) { take_turn(turns[turn]); }) {
    boot(s);
    for (size_t g = 0; g < plant.group_count(); ++g)
        std::copy_n(plant.group(g).gear_rad, lane_count, &gears_rad[g * lane_count]);
    for (size_t i = 0; i < count; ++i) publish(i);
    seen = next;
    if (feel) neighbours.plan_first_looks(seen);
}

void Twin::State::boot(const TwinSetup &s) {
    for (size_t g = 0; g < plant.group_count(); ++g) {
        groups[g].plant = &plant;
        groups[g].lanes = &plant.group(g);
    }
    for (size_t i = 0; i < s.ids.size(); ++i) {
        uint16_t &index = index_of_id[s.ids[i]];
        if (index != no_index)
            throw std::invalid_argument("positioner id " + std::to_string(s.ids[i]) + " occurs twice");
        index = static_cast<uint16_t>(i);
        Positioner &p = positioners[i];
        p.attach(groups[i / lane_group_size], i);
        p.boot(s.ids[i], first_params, &s.params[2 * i]);
    }
    for (size_t g = 0; g < plant.group_count(); ++g) {
        const size_t first = g * lane_group_size;
        lane_groups[g].attach(plant, g, &positioners[first], std::min<size_t>(lane_group_size, count - first),
                              s.side_by_side);
        plant.sense(g, 0); // the first hall reading is real
    }
    for (size_t i = 0; i < s.ids.size(); ++i) {
        int32_t position[FL_AXES], stop[FL_AXES];
        for (size_t axis = 0; axis < FL_AXES; ++axis) {
            const double gear_ratio = plant.params(2 * i + axis).gear_ratio;
            position[axis] = wire_count(plant.motor_rad(2 * i + axis), gear_ratio);
            stop[axis] = wire_count(plant.lower_stop_rad(2 * i + axis) - wound_rad, gear_ratio);
        }
        positioners[i].deliver(position, stop);
    }
}

// What pushes the arms of a group: all of them are looked at every 2 ms, those that touch in every tick.
void Twin::State::feel_group(size_t group) {
    const Rows rows = rows_of(group);
    for (size_t i = rows.begin; i < rows.end; ++i)
        if (at_sync() ? felt[i] != 0 || neighbours.due(i, now) : pushed[i] != 0)
            feel_neighbours(i, groups[group].outbox);
}

bool Twin::State::in_contact(size_t group) const {
    const Rows rows = rows_of(group);
    for (size_t i = rows.begin; i < rows.end; ++i)
        if (touches(i)) return true;
    return false;
}

// Whether forces on arms of the group may change before the next sync point; notes on which: those that touch
// something, and either of the two is awake. No other contact has a say in it.
bool Twin::State::pushes(size_t group) {
    const auto moves = [this](const Contact &c) { return c.other < count && !positioners[c.other].asleep(); };
    const Rows rows = rows_of(group);
    bool any = false;
    for (size_t i = rows.begin; i < rows.end; ++i) {
        const Positioner &p = positioners[i];
        const auto &contacts = p.touch().contacts;
        pushed[i] = touches(i) && (!p.asleep() || std::any_of(contacts.begin(), contacts.end(), moves));
        any |= pushed[i] != 0;
    }
    return any;
}

// One task of a slice: this group's neighbours, then its ticks, unless its arms touch. Reads `seen`.
void Twin::State::take_turn(size_t group) {
    const bool waited = close[group] != 0;
    if (feel && !(waited && now == begun)) feel_group(group);
    if (feel && !waited && in_contact(group))
        close[group] = 1;
    else
        run_group(group, slice);
}

// Writes `next`, for those whom somebody looks at next.
void Twin::State::run_group(size_t group, uint64_t ticks) {
    const Rows rows = rows_of(group);
    LaneGroup &lane_group = lane_groups[group];
    if (!lane_group.gather()) return;
    LawScratch scratch{};
    for (uint64_t tick = now; tick < now + ticks; ++tick) {
        const uint64_t used = scoped[group] != 0 ? every_lane : lane_group.used();
        plant.sense(group, static_cast<uint32_t>(tick), used);
        lane_group.tick(tick, scratch);
        plant.step(group, used);
        for (uint32_t left = scoped[group]; left != 0; left &= left - 1)
            positioners[rows.begin + static_cast<size_t>(std::countr_zero(left))].record(plant, tick);
        if (loaded && (tick + 1) % load_ticks == 0) follow_loads(rows);
    }
    const uint32_t fell = lane_group.rest(now + ticks, skip_resting);
    for (size_t i = rows.begin; feel && i < rows.end; ++i)
        if ((fell >> (i - rows.begin) & 1U) != 0 || neighbours.shown(i, now + ticks)) publish(i);
    if (feel && (now + ticks) % sync_ticks == 0) travel(group);
}

// The gears since the last look. An arm that is pushed bends, too: it may be anywhere that it could have
// come.
void Twin::State::travel(size_t group) {
    const Rows rows = rows_of(group);
    const double *gear_rad = plant.group(group).gear_rad;
    double *before_rad = &gears_rad[group * lane_count];
    for (size_t i = rows.begin, lane = 0; i < rows.end; ++i, ++lane) {
        const double alpha_rad = std::abs(gear_rad[lane] - before_rad[lane]);
        const double beta_rad =
            std::abs(gear_rad[lane + lane_group_size] - before_rad[lane + lane_group_size]);
        next_travels_mm[i] +=
            felt[i] != 0 ? neighbours.farthest_mm(i) : neighbours.travel_mm(i, alpha_rad, beta_rad);
    }
    std::copy_n(gear_rad, lane_count, before_rad);
}

void Twin::State::show_poses() {
    travels_mm = next_travels_mm;
    for (size_t group = 0; group < groups.size(); ++group)
        for (uint32_t left = std::exchange(groups[group].posed, 0); left != 0; left &= left - 1) {
            const size_t i = group * lane_group_size + static_cast<size_t>(std::countr_zero(left));
            seen[i] = next[i];
        }
}

void Twin::State::publish(size_t i) {
    groups[i / lane_group_size].posed |= 1U << i % lane_group_size;
    const Angles rigid = at_rest(i);
    next[i] = neighbours.pose(
        i, {rigid.alpha_rad + plant.deflection_rad(2 * i), rigid.beta_rad + plant.deflection_rad(2 * i + 1)},
        rigid);
}

void Twin::State::feel_neighbours(size_t i, Outbox &outbox) {
    std::vector<Contact> contacts;
    if (felt[i] != 0) contacts = std::move(positioners[i].touching->contacts);
    const Push push = neighbours.push(i, seen, travels_mm, now, contacts);
    // most touch nothing, before and after: the positioner itself, far from the processor, is not asked then
    if (felt[i] == 0 && contacts.empty() && push == Push{}) return;
    Positioner &p = positioners[i];
    if (!contacts.empty() || p.touching) p.touch_now().contacts = std::move(contacts);
    note_touches(i, outbox);
    if (push != p.touch().push) apply_torque(i, push);
    const Touching &touch = p.touch();
    felt[i] = !touch.contacts.empty() || !touch.touched.empty() || touch.push != Push{};
    if (p.touching && p.touching->over()) p.touching.reset();
}

void Twin::State::note_touches(size_t i, Outbox &outbox) {
    if (!positioners[i].touching) return;
    Touching &p = *positioners[i].touching;
    for (LastTouch &t : p.touched) {
        if (in_touch(p.contacts, t.other))
            t.forget_tick = UINT64_MAX;
        else if (t.forget_tick == UINT64_MAX)
            t.forget_tick = now + bounce_ticks;
    }
    std::erase_if(p.touched, [this](const LastTouch &t) { return t.forget_tick <= now; });
    for (const Contact &c : p.contacts) {
        const auto same = [&c](const LastTouch &t) { return t.other == c.other; };
        if (std::any_of(p.touched.begin(), p.touched.end(), same)) continue;
        p.touched.push_back({c.other, UINT64_MAX});
        if (i < c.other) outbox.touches.push_back({now, static_cast<uint32_t>(i), c.other});
    }
}

void Twin::State::apply_torque(size_t i, const Push &push) {
    Positioner &p = positioners[i];
    next_travels_mm[i] += neighbours.farthest_mm(i);
    if (p.touching || push != Push{}) p.touch_now().push = push;
    p.wake(now); // the rotor may give way
    put_torque(i);
}

void Twin::State::put_torque(size_t i) {
    const Positioner &p = positioners[i];
    const Touching &touch = p.touch();
    double load_Nm[FL_AXES] = {0.0, 0.0};
    if (p.loads) {
        const LoadTorque torque = p.loads->torque(gravity);
        load_Nm[FL_ALPHA] = torque.alpha_Nm;
        load_Nm[FL_BETA] = torque.beta_Nm;
    }
    for (size_t axis = 0; axis < FL_AXES; ++axis)
        plant.set_external_torque(2 * i + axis, touch.push.torque_Nm[axis] + touch.user_push.torque_Nm[axis] +
                                                    load_Nm[axis]);
}

Angles Twin::State::at_rest(size_t i) const {
    return {plant.output_at_rest_rad(2 * i), plant.output_at_rest_rad(2 * i + 1)};
}

// What pulls at the arms of a group turns with them.
void Twin::State::follow_loads(Rows rows) {
    for (size_t i = rows.begin; i < rows.end; ++i) {
        const Positioner &p = positioners[i];
        if (p.loads && p.loads->turn(at_rest(i))) put_torque(i);
    }
}

bool Twin::State::any_awake() const {
    return std::any_of(groups.begin(), groups.end(), [](const PositionerGroup &g) { return g.awake != 0; });
}

// To the next sync point; to one further on where no arm can touch another before.
uint64_t Twin::State::slice_ticks() const {
    if (!feel) return lone_ticks;
    const uint64_t to_sync = sync_ticks - now % sync_ticks;
    const auto touches_now = [](uint8_t f) { return f != 0; };
    if (to_sync != sync_ticks || std::any_of(felt.begin(), felt.end(), touches_now)) return to_sync;
    const uint64_t due = neighbours.next_due();
    return std::clamp(due - std::min(due, now), sync_ticks, lone_ticks);
}

void Twin::State::run_slice(uint64_t ticks) {
    begun = now;
    slice = ticks;
    turns.resize(plant.group_count());
    std::iota(turns.begin(), turns.end(), size_t{0});
    std::fill(close.begin(), close.end(), uint8_t{0});
    workers.run(turns.size());
    run_closely(ticks);
    if (at_sync()) show_poses();
}

// The groups that are left, tick by tick where a force may change.
void Twin::State::run_closely(uint64_t ticks) {
    turns.clear();
    for (size_t group = 0; group < close.size(); ++group) {
        if (close[group] == 0) continue;
        if (pushes(group))
            turns.push_back(group);
        else
            run_group(group, ticks);
    }
    if (turns.empty()) ticks = 0, now += slice;
    slice = 1;
    for (uint64_t k = 0; k < ticks; ++k) {
        workers.run(turns.size());
        ++now;
        for (const size_t group : turns) {
            const Rows rows = rows_of(group);
            std::copy(&next[rows.begin], &next[0] + rows.end, &seen[rows.begin]);
        }
    }
}

std::vector<Reply> Twin::State::collect() {
    std::vector<Sent> all;
    for (PositionerGroup &group : groups) {
        Outbox &box = group.outbox;
        all.insert(all.end(), box.frames.begin(), box.frames.end());
        if (!box.frames.empty()) box.frames = std::vector<Sent>(); // few ticks have replies
    }
    std::stable_sort(all.begin(), all.end(), [](const Sent &a, const Sent &b) {
        return a.reply.tick != b.reply.tick ? a.reply.tick < b.reply.tick : a.sender < b.sender;
    });
    std::vector<Reply> replies;
    for (const Sent &sent : all) replies.push_back(sent.reply);
    return replies;
}

Twin::Twin(const TwinSetup &setup) : s_(std::make_unique<State>(setup)) {}
Twin::~Twin() = default;

size_t Twin::positioner_count() const { return s_->count; }
uint64_t Twin::tick() const { return s_->now; }
Plant &Twin::plant() { return s_->plant; }
const Neighbours &Twin::neighbours() const { return s_->neighbours; }
const char *Twin::kernel_name() const { return s_->plant.kernel_name(); }

void Twin::State::hear(size_t i, const fl_can_frame_t &frame, int bus) {
    if (bus != every_bus && positioners[i].bus != bus) return;
    release(i);
    positioners[i].receive(frame, now);
}

void Twin::send(const fl_can_frame_t &frame, int bus) {
    const uint32_t id = frame.id >> 18 & 0x7ff;
    if (id == 0) {
        for (size_t i = 0; i < s_->count; ++i) {
            if (i + 1 < s_->count) s_->positioners[i + 1].fetch();
            s_->hear(i, frame, bus);
        }
    } else if (id < s_->index_of_id.size() && s_->index_of_id[id] != no_index) {
        s_->hear(s_->index_of_id[id], frame, bus);
    }
}

void Twin::connect(size_t i, int bus) { s_->at(i).bus = bus; }

std::vector<Reply> Twin::run(uint64_t ticks) {
    const uint64_t end = s_->now + ticks;
    while (s_->now < end) {
        const bool resting = !s_->any_awake(), at_sync = !s_->feel || s_->at_sync();
        if (resting && s_->quiet) {
            s_->now = end;
            break;
        }
        s_->run_slice(std::min(s_->slice_ticks(), end - s_->now));
        s_->quiet = resting && at_sync && !s_->any_awake();
    }
    return s_->collect();
}

Angles Twin::output(size_t i) const {
    s_->check(i);
    return {s_->plant.output_rad(2 * i), s_->plant.output_rad(2 * i + 1)};
}

const fl_positioner_t &Twin::firmware(size_t i) const { return s_->at(i).firmware(); }
bool Twin::asleep(size_t i) const {
    s_->check(i);
    return s_->positioners[i].asleep();
}
bool Twin::resting() const { return s_->quiet && !s_->any_awake(); }

size_t Twin::single_ticks() const {
    size_t sum = 0;
    for (const LaneGroup &group : s_->lane_groups) sum += group.single_ticks();
    return sum;
}

uint64_t Twin::ticks_skipped() const {
    uint64_t sum = 0;
    for (const PositionerGroup &group : s_->groups) sum += group.skipped;
    return sum;
}

uint64_t Twin::ticks_run() const {
    uint64_t sum = 0;
    for (size_t i = 0; i < s_->count; ++i) s_->release(i);
    for (const PositionerGroup &group : s_->groups) sum += group.ticks_run;
    return sum;
}

// The firmware's own state is a board's business.
size_t Twin::bytes_per_positioner() const {
    const auto held = [](const auto &list) { return list.capacity() * sizeof(list[0]); };
    size_t bytes = sizeof(State) + s_->plant.bytes() + s_->neighbours.bytes() + held(s_->lane_groups);
    for (size_t i = 0; i < s_->count; ++i) bytes += s_->positioners[i].bytes();
    for (const LaneGroup &group : s_->lane_groups) bytes += group.bytes();
    for (const PositionerGroup &g : s_->groups) bytes += held(g.outbox.frames) + held(g.outbox.touches);
    bytes += held(s_->groups) + held(s_->seen) + held(s_->next) + held(s_->travels_mm) +
             held(s_->next_travels_mm) + held(s_->gears_rad) + held(s_->felt) + held(s_->pushed);
    bytes += held(s_->scoped) + held(s_->close) + held(s_->turns) + held(s_->index_of_id);
    return s_->count == 0 ? 0 : (bytes + s_->count - 1) / s_->count;
}

void Twin::set_external_torque(size_t i, int axis, double torque_Nm) {
    Positioner &p = s_->at(i);
    p.touch_now().user_push.torque_Nm[axis] = torque_Nm;
    s_->apply_torque(i, p.touch().push);
    if (p.touch().over()) p.touching.reset();
}

void Twin::set_loads(size_t i, const AxisLoad &alpha, const AxisLoad &beta) {
    Positioner &p = s_->at(i);
    const Arm &arm = s_->neighbours.arm(i);
    const Angles zero = {arm.alpha_off_rad, arm.beta_off_rad};
    p.loads = std::make_unique<ArmLoads>(alpha, beta, zero, s_->at_rest(i));
    s_->loaded = true;
    s_->apply_torque(i, p.touch().push);
}

void Twin::point(Gravity gravity) {
    s_->gravity = gravity;
    for (size_t i = 0; i < s_->count; ++i)
        if (s_->positioners[i].loads) s_->apply_torque(i, s_->positioners[i].touch().push);
}
void Twin::set_temperature(size_t i, uint32_t counts) { s_->at(i).temperature_cnt = counts; }

void Twin::set_faults(size_t i, const PositionerFaults &faults) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.set_faults(faults);
    for (size_t axis = 0; axis < FL_AXES; ++axis) s_->plant.set_faults(2 * i + axis, faults.axes[axis]);
}

const PositionerFaults &Twin::faults(size_t i) const { return s_->at(i).faults(); }

void Twin::set_transmission(size_t i, int axis, const Transmission &transmission) {
    s_->at(i).wake(s_->now);
    s_->plant.set_transmission(2 * i + static_cast<size_t>(axis), transmission);
}

void Twin::set_params(size_t i, int axis, const PlantParams &params) {
    s_->at(i).wake(s_->now);
    s_->plant.set_params(2 * i + static_cast<size_t>(axis), params);
}

void Twin::power_cycle(size_t i, bool bootloader) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.power_cycle();
    if (bootloader) fl_positioner_enter_bootloader(&p.firmware());
}

void Twin::power_up(size_t i, int alpha_turns, int beta_turns) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    const int turns[FL_AXES] = {alpha_turns, beta_turns};
    p.power_up(turns);
}

void Twin::scope(size_t i, int axis, bool on) {
    Positioner &p = s_->at(i);
    p.wake(s_->now);
    p.start_scope(axis, on);
    const uint32_t bit = 1U << i % lane_group_size;
    uint32_t &scoped = s_->scoped[i / lane_group_size];
    scoped = p.scoped() ? scoped | bit : scoped & ~bit;
}

std::vector<ScopeSample> Twin::take_scope(size_t i, int axis) { return s_->at(i).take_scope(axis); }

std::vector<Touch> Twin::take_touches() {
    std::vector<Touch> all;
    for (PositionerGroup &group : s_->groups) {
        all.insert(all.end(), group.outbox.touches.begin(), group.outbox.touches.end());
        group.outbox.touches.clear();
    }
    std::stable_sort(all.begin(), all.end(), [](const Touch &a, const Touch &b) { return a.tick < b.tick; });
    return all;
}

} // namespace fl::twin
