// The rig, told what to do by lines; the same program on the host and on the target.
//
// Numbers of the unit and all floating point go as the hexadecimal digits of their bits, so that nothing is
// lost on the way. Every line is answered by lines, the last of which is "." or, refused, "? why".
//
//   plant AXIS INDEX BITS64    parameter of the true axis, in the order of FL_PLANT_PARAMS
//   gear AXIS INDEX BITS64     number of its transmission, in the order of twin::Transmission
//   start AXIS BITS64          output angle, rad
//   param AXIS INDEX BITS32    what the firmware is told, in the order of FL_AXIS_PARAMS
//   begin SEED                 makes the unit and switches it on
//   place                      tells the firmware where the motors are
//   send ID DATA               a frame, hexadecimal; "-" for no data
//   run N                      N ticks; rest N: until the axes rest, at most N
//   power                      off and on again
//   cut N                      the storage takes N more bytes, then nothing; -1: everything again
//   block AXIS 0|1             holds the rotor
//   boot                       into the bootloader
//   look                       the truth, and what the firmware makes of it
//   deep 0|1                   whether cost looks at the stack, too
//   cost                       instructions in ticks, frames and power-up since the last time, bytes of stack
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include "io.h"
#include "rig.hpp"

namespace fl::rig {
namespace {

constexpr int gear_count = sizeof(twin::Transmission) / sizeof(double);
constexpr int param_count = sizeof(fl_axis_params_t) / sizeof(float);

struct Session {
    Setup setup;
    std::unique_ptr<Rig> rig;
};

const char *const refused_axis = "axis is 0 or 1";
const char *const refused_index = "no such index";

uint64_t number(const char *&at, int base) {
    char *end;
    const uint64_t value = std::strtoull(at, &end, base);
    at = end;
    return value;
}

template <class T, class Bits> T from_bits(Bits bits) {
    static_assert(sizeof(T) == sizeof(Bits));
    T value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

unsigned long long bits_of(double value) { return from_bits<uint64_t>(value); }

// One number of a row of numbers, by AXIS INDEX BITS.
template <class T, class Bits> const char *put(const char *at, void *rows[FL_AXES], int count) {
    const uint64_t axis = number(at, 10), index = number(at, 10);
    if (axis >= FL_AXES) return refused_axis;
    if (index >= static_cast<uint64_t>(count)) return refused_index;
    const T value = from_bits<T>(static_cast<Bits>(number(at, 16)));
    std::memcpy(static_cast<char *>(rows[axis]) + index * sizeof(T), &value, sizeof value);
    return nullptr;
}

const char *do_plant(Session &s, const char *at) {
    void *rows[FL_AXES] = {&s.setup.unit[0].params, &s.setup.unit[1].params};
    return put<double, uint64_t>(at, rows, twin::plant_param_count);
}

const char *do_gear(Session &s, const char *at) {
    void *rows[FL_AXES] = {&s.setup.unit[0].transmission, &s.setup.unit[1].transmission};
    return put<double, uint64_t>(at, rows, gear_count);
}

const char *do_param(Session &s, const char *at) {
    void *rows[FL_AXES] = {&s.setup.params[0], &s.setup.params[1]};
    return put<float, uint32_t>(at, rows, param_count);
}

const char *do_start(Session &s, const char *at) {
    const uint64_t axis = number(at, 10);
    if (axis >= FL_AXES) return refused_axis;
    s.setup.start_rad[axis] = from_bits<double>(number(at, 16));
    return nullptr;
}

const char *do_begin(Session &s, const char *at) {
    s.setup.seed = number(at, 10);
    s.rig.reset(); // the memory of the old one, on a small machine
    s.rig.reset(new Rig(s.setup));
    return nullptr;
}

void tell_sent(Rig &r) {
    for (uint32_t i = 0; i < r.sent_count; ++i) {
        const fl_can_frame_t &f = r.sent[i];
        char line[64];
        int n = std::snprintf(line, sizeof line, "tx %lu %08lx ", static_cast<unsigned long>(r.ticks()),
                              static_cast<unsigned long>(f.id));
        for (int k = 0; k < f.len; ++k)
            n += std::snprintf(line + n, sizeof line - static_cast<size_t>(n), "%02x", f.data[k]);
        line[n] = '\n';
        line[n + 1] = '\0';
        io_write(line);
    }
    r.sent_count = 0;
}

const char *do_send(Session &s, const char *at) {
    fl_can_frame_t f = {static_cast<uint32_t>(number(at, 16)), 0, {}};
    while (*at == ' ') ++at;
    while (std::isxdigit(static_cast<unsigned char>(at[0])) && at[1] != '\0') {
        if (f.len == 8) return "more than 8 bytes";
        const char byte[3] = {at[0], at[1], '\0'};
        f.data[f.len++] = static_cast<uint8_t>(std::strtoul(byte, nullptr, 16));
        at += 2;
    }
    s.rig->receive(f);
    tell_sent(*s.rig);
    return nullptr;
}

const char *run(Rig &r, uint64_t ticks, bool until_rest) {
    for (uint64_t n = 0; n < ticks && !(until_rest && r.at_rest()); ++n) {
        r.tick();
        tell_sent(r);
    }
    return until_rest && !r.at_rest() ? "does not come to rest" : nullptr;
}

const char *do_run(Session &s, const char *at) { return run(*s.rig, number(at, 10), false); }
const char *do_rest(Session &s, const char *at) { return run(*s.rig, number(at, 10), true); }

const char *do_place(Session &s, const char *) {
    s.rig->place();
    return nullptr;
}

const char *do_power(Session &s, const char *) {
    s.rig->power_up();
    return nullptr;
}

const char *do_cut(Session &s, const char *at) {
    s.rig->write_budget = std::strtoll(at, nullptr, 10);
    return nullptr;
}

const char *do_block(Session &s, const char *at) {
    const auto axis = static_cast<size_t>(number(at, 10));
    if (axis >= FL_AXES) return refused_axis;
    twin::AxisFaults faults = s.rig->plant().faults(axis);
    faults.blocked = number(at, 10) != 0;
    s.rig->plant().set_faults(axis, faults);
    return nullptr;
}

const char *do_boot(Session &s, const char *) {
    fl_positioner_enter_bootloader(&s.rig->firmware());
    return nullptr;
}

const char *do_look(Session &s, const char *) {
    Rig &r = *s.rig;
    char line[160];
    for (int axis = 0; axis < FL_AXES; ++axis) {
        const twin::AxisState t = r.plant().state(static_cast<size_t>(axis));
        std::snprintf(line, sizeof line, "axis %d %016llx %016llx %016llx %016llx %ld\n", axis,
                      bits_of(t.theta_rad), bits_of(t.momentum_Nms), bits_of(t.gear_rad),
                      bits_of(t.output_rad), static_cast<long>(fl_positioner_position(&r.firmware(), axis)));
        io_write(line);
        const float *params = reinterpret_cast<const float *>(&r.firmware().params[axis]);
        int n = std::snprintf(line, sizeof line, "params %d", axis);
        for (int i = 0; i < param_count; ++i) {
            n += std::snprintf(line + n, sizeof line - static_cast<size_t>(n), " %08lx",
                               static_cast<unsigned long>(from_bits<uint32_t>(params[i])));
            if (n > 120 || i + 1 == param_count) {
                io_write(line);
                n = 0;
            }
        }
        io_write("\n");
    }
    std::snprintf(line, sizeof line, "firmware %lu %u %016llx %08lx\n", static_cast<unsigned long>(r.ticks()),
                  static_cast<unsigned>(r.firmware().state),
                  static_cast<unsigned long long>(r.firmware().status),
                  static_cast<unsigned long>(r.digest()));
    io_write(line);
    return nullptr;
}

void tell_cost(const char *name, Cost &c) {
    const unsigned long per_count = io_instructions_per_count;
    char line[96];
    std::snprintf(line, sizeof line, "cost %s %lu %llu %lu %lu\n", name, static_cast<unsigned long>(c.calls),
                  static_cast<unsigned long long>(c.sum * per_count), c.most * per_count,
                  static_cast<unsigned long>(c.deepest));
    io_write(line);
    c = Cost{};
}

const char *do_deep(Session &s, const char *at) {
    s.rig->look_deep = number(at, 10) != 0;
    return nullptr;
}

const char *do_cost(Session &s, const char *) {
    tell_cost("tick", s.rig->tick_cost);
    tell_cost("frame", s.rig->frame_cost);
    tell_cost("boot", s.rig->boot_cost);
    return nullptr;
}

struct Verb {
    const char *name;
    const char *(*act)(Session &, const char *);
    bool needs_rig;
};

const Verb verbs[] = {
    {"plant", do_plant, false}, {"gear", do_gear, false},   {"start", do_start, false},
    {"param", do_param, false}, {"begin", do_begin, false}, {"place", do_place, true},
    {"send", do_send, true},    {"run", do_run, true},      {"rest", do_rest, true},
    {"power", do_power, true},  {"cut", do_cut, true},      {"block", do_block, true},
    {"boot", do_boot, true},    {"look", do_look, true},    {"cost", do_cost, true},
    {"deep", do_deep, true},
};

const char *obey(Session &s, const char *line) {
    for (const Verb &v : verbs) {
        const size_t n = std::strlen(v.name);
        if (std::strncmp(line, v.name, n) != 0 || (line[n] != ' ' && line[n] != '\0')) continue;
        if (v.needs_rig && !s.rig) return "begin first";
        return v.act(s, line + n);
    }
    return "no such command";
}

void answer(Session &s, const char *line) {
    const char *refused = obey(s, line);
    if (refused == nullptr) {
        io_write(".\n");
        return;
    }
    io_write("? ");
    io_write(refused);
    io_write("\n");
}

} // namespace
} // namespace fl::rig

int main() {
    static fl::rig::Session session;
    char line[96];
    while (io_read_line(line, sizeof line)) fl::rig::answer(session, line);
    return 0;
}
