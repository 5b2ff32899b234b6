// How the arms of a twin feel each other, and what else pulls at them.
#include <bit>
#include <cmath>
#include <utility>

#include "twin_state.hpp"

namespace fl::twin {
namespace {

constexpr uint64_t bounce_ticks = 80; // what comes back within 40 ms is the same contact

} // namespace

Give give_of(const Plant &plant, size_t i) {
    Give g;
    for (size_t k = 0; k < FL_AXES; ++k) {
        const size_t axis = 2 * i + k;
        const AxisFaults &faults = plant.faults(axis);
        const double follows = std::max({1.0, std::abs(faults.follows_up), std::abs(faults.follows_down)});
        g.compliance_rad_per_Nm[k] = plant.compliance_rad_per_Nm(axis);
        g.speed[k] = speed_bound(plant.params(axis));
        g.output_per_motor[k] = follows * plant.output_per_motor(axis);
    }
    return g;
}

// What pushes the arms of a group: all of them are looked at every 2 ms, those that touch in every tick.
void Twin::State::feel_group(size_t group) {
    for (const size_t i : members(group))
        if (at_sync() ? felt[i] != 0 || neighbours.due(i) <= now + ahead : pushed[i] != 0)
            feel_neighbours(i, groups[group]);
}

bool Twin::State::in_contact(size_t group) const {
    const auto all = members(group);
    return std::any_of(all.begin(), all.end(), [this](size_t i) { return touches(i); });
}

// Whether forces on arms of the group may change before the next sync point; notes on which: those that touch
// something, and either of the two is awake. No other contact has a say in it.
bool Twin::State::pushes(size_t group) {
    const auto moves = [this](const Contact &c) { return c.other < count && !positioners[c.other].asleep(); };
    bool any = false;
    for (const size_t i : members(group)) {
        const Positioner &p = positioners[i];
        const auto &contacts = p.touch().contacts;
        pushed[i] = touches(i) && (!p.asleep() || std::any_of(contacts.begin(), contacts.end(), moves));
        any |= pushed[i] != 0;
    }
    return any;
}

// Before a look: where the arms of a group are that somebody asks for, and how all of them have moved.
void Twin::State::show_group(size_t group) {
    for (const size_t i : members(group))
        if (neighbours.shown(i, now + ahead)) publish(i);
    if (std::exchange(groups[group].moved, false)) travel(group);
}

// The gears since the last look. An arm that is pushed bends, too: it may be anywhere that it could have
// come.
void Twin::State::travel(size_t group) {
    const auto way_rad = [this](size_t axis) {
        const double before_rad = std::exchange(gears_rad[axis], plant.gear_rad(axis));
        return std::abs(gears_rad[axis] - before_rad);
    };
    for (const size_t i : members(group)) {
        const double alpha_rad = way_rad(2 * i), beta_rad = way_rad(2 * i + 1);
        next_travels[i].way_mm +=
            felt[i] != 0 ? neighbours.farthest_mm(i) : neighbours.travel_mm(i, alpha_rad, beta_rad);
        next_travels[i].speed_mm = speed_mm(i);
    }
}

// Of an arm, a tick, as fast as its motors turn now; see Travel.
double Twin::State::speed_mm(size_t i) const {
    if (felt[i] != 0) return Travel::pushed;
    return neighbours.travel_mm(i, plant.motor_turn_rad(plant.place(2 * i)),
                                plant.motor_turn_rad(plant.place(2 * i + 1)));
}

void Twin::State::show_poses() {
    travels = next_travels;
    for (size_t group = 0; group < groups.size(); ++group)
        for (uint32_t left = std::exchange(groups[group].posed, 0); left != 0; left &= left - 1) {
            const size_t i = members(group)[static_cast<size_t>(std::countr_zero(left))];
            seen[i] = next[i];
        }
}

void Twin::State::publish(size_t i) {
    groups[place(i).group].posed |= 1U << place(i).lane;
    const Angles rigid = at_rest(i);
    next[i] = neighbours.pose(
        i, {rigid.alpha_rad + plant.deflection_rad(2 * i), rigid.beta_rad + plant.deflection_rad(2 * i + 1)},
        rigid);
}

void Twin::State::feel_neighbours(size_t i, PositionerGroup &group) {
    std::vector<Contact> contacts;
    if (felt[i] != 0) contacts = std::move(positioners[i].touching->contacts);
    const uint64_t sooner = at_sync() ? ahead : 0;
    const Push push = neighbours.push(i, {seen, travels, now, sooner}, contacts);
    // most touch nothing, before and after: the positioner itself, far from the processor, is not asked then
    if (felt[i] == 0 && contacts.empty() && push == Push{}) return;
    Positioner &p = positioners[i];
    if (!contacts.empty() || p.touching) p.touch_now().contacts = std::move(contacts);
    note_touches(i, group.outbox);
    if (felt[i] == 0) group.disturbed |= 1U << place(i).lane;
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
    next_travels[i].way_mm += neighbours.farthest_mm(i);
    if (p.touching || push != Push{}) p.touch_now().push = push;
    p.wake(now); // the rotor may give way
    put_torque(i);
}

// Something else than neighbours pulls at the arms of positioner i from now on.
void Twin::State::bend(size_t i) {
    apply_torque(i, positioners[i].touch().push);
    if (neighbours.allow_loose(i, loose(i))) disturb_all();
    disturb(i);
}

// Positioner i is no longer what it was.
void Twin::State::learn(size_t i) {
    const bool faster = neighbours.allow(i, give_of(plant, i)), looser = neighbours.allow_loose(i, loose(i));
    if (faster || looser) disturb_all();
    disturb(i);
}

// Whatever is known of how positioner i moves is out of date: it is looked at at the first sync point from
// now on.
void Twin::State::disturb(size_t i) {
    neighbours.disturb(i, (now + sync_ticks - 1) / sync_ticks * sync_ticks);
}

void Twin::State::disturb_all() {
    for (size_t i = 0; i < count; ++i) disturb(i);
}

// Where its teeth seat and what its loads bend, from one end to the other.
Angles Twin::State::loose(size_t i) const {
    Angles bent;
    if (const auto &loads = positioners[i].loads) {
        const auto turn_rad = [&](size_t axis) {
            return plant.param(axis, &PlantParams::stop_max) - plant.param(axis, &PlantParams::stop_min);
        };
        const LoadTorque range = loads->range({turn_rad(2 * i), turn_rad(2 * i + 1)}, gravity);
        bent.alpha_rad = range.alpha_Nm * plant.compliance_rad_per_Nm(2 * i);
        bent.beta_rad = range.beta_Nm * plant.compliance_rad_per_Nm(2 * i + 1);
    }
    return {bent.alpha_rad + 2.0 * plant.seat_limit_rad(2 * i),
            bent.beta_rad + 2.0 * plant.seat_limit_rad(2 * i + 1)};
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

// What pulls at the arms of a group turns with them. One that sleeps has not turned since.
void Twin::State::follow_loads(size_t group) {
    for (uint32_t left = groups[group].awake; left != 0; left &= left - 1) {
        const size_t i = members(group)[static_cast<size_t>(std::countr_zero(left))];
        const Positioner &p = positioners[i];
        if (p.loads && p.loads->turn(at_rest(i))) put_torque(i);
    }
}

} // namespace fl::twin
