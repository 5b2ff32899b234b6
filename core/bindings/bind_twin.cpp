// The plant alone, for tests and identification studies, and the whole twin.
#include <cstring>

#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include "bind.hpp"
#include "fiberloom/twin/real_time.hpp"
#include "fiberloom/twin/twin.hpp"

namespace {

using namespace fl::twin;
using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Floats = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Rows2 = nb::ndarray<const double, nb::shape<-1, 2>, nb::c_contig, nb::device::cpu>;
using Rows5 = nb::ndarray<const double, nb::shape<-1, 5>, nb::c_contig, nb::device::cpu>;

constexpr size_t param_doubles = sizeof(PlantParams) / sizeof(double);
constexpr size_t transmission_doubles = sizeof(Transmission) / sizeof(double);
constexpr size_t firmware_floats = sizeof(fl_axis_params_t) / sizeof(float);

size_t rows_of(size_t size, size_t width, const char *what) {
    if (size % width != 0)
        throw nb::value_error(
            (std::string(what) + ": rows of " + std::to_string(width) + " numbers").c_str());
    return size / width;
}

std::vector<Unit> units_of(const Doubles &params, const Doubles &transmission) {
    const size_t n = rows_of(params.size(), param_doubles, "plant");
    if (rows_of(transmission.size(), transmission_doubles, "transmission") != n)
        throw nb::value_error("plant and transmission need the same number of axes");
    std::vector<Unit> units(n);
    for (size_t i = 0; i < n; ++i) {
        std::memcpy(static_cast<void *>(&units[i].params), params.data() + i * param_doubles,
                    sizeof(PlantParams));
        std::memcpy(static_cast<void *>(&units[i].transmission),
                    transmission.data() + i * transmission_doubles, sizeof(Transmission));
    }
    return units;
}

Transmission transmission_of(const Input1<double> &row) {
    if (row.size() != transmission_doubles)
        throw nb::value_error("transmission: one row of TRANSMISSION_SIZE");
    Transmission t;
    std::memcpy(static_cast<void *>(&t), row.data(), sizeof t);
    return t;
}

PlantParams params_of(const Input1<double> &row) {
    if (row.size() != param_doubles) throw nb::value_error("plant: one row of PLANT_PARAMS");
    PlantParams p;
    std::memcpy(static_cast<void *>(&p), row.data(), sizeof p);
    return p;
}

nb::list plant_params() {
    nb::list out;
    for (const PlantParamInfo &p : plant_param_infos)
        out.append(nb::make_tuple(p.name, p.unit, p.min, p.max, p.def, p.doc));
    return out;
}

nb::list kernel_list() {
    nb::list out;
    for (const Kernel *const *k = kernels(); *k != nullptr; ++k) out.append((*k)->name);
    return out;
}

// --- the plant ---------------------------------------------------------------------------------

struct TestPlant {
    Plant plant;
    uint32_t tick = 0;
};

void set_duty(Plant &plant, const double *duty) {
    for (size_t i = 0; i < plant.axis_count(); ++i)
        for (size_t k = 0; k < 3; ++k)
            plant.group(Plant::place(i).group).duty[k][Plant::place(i).lane] =
                static_cast<float>(duty[3 * i + k]);
}

void write_row(Plant &plant, double *row, int32_t *hall) {
    for (size_t i = 0; i < plant.axis_count(); ++i) {
        const AxisState s = plant.state(i);
        const double values[4] = {s.theta_rad, s.momentum_Nms, s.gear_rad, s.output_rad};
        std::copy(values, values + 4, row + 4 * i);
        for (size_t k = 0; k < 2; ++k)
            hall[2 * i + k] = plant.group(Plant::place(i).group).hall_cnt[k][Plant::place(i).lane];
    }
}

void plant_ticks(TestPlant &p, const double *duty, size_t ticks, double *log, int32_t *hall) {
    const size_t n = p.plant.axis_count();
    for (size_t t = 0; t < ticks; ++t, ++p.tick) {
        set_duty(p.plant, duty + t * n * 3);
        for (size_t g = 0; g < p.plant.group_count(); ++g) {
            p.plant.sense(g, p.tick);
            p.plant.step(g);
        }
        write_row(p.plant, log + t * n * 4, hall + t * n * 2);
    }
}

nb::tuple plant_run(TestPlant &p,
                    const nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu> &duty) {
    const size_t n = p.plant.axis_count(), ticks = duty.shape(0);
    if (duty.shape(1) != n || duty.shape(2) != 3) throw nb::value_error("duty: (ticks, axes, 3)");
    auto log = new_array<double>({ticks, n, 4});
    auto hall = new_array<int32_t>({ticks, n, 2});
    {
        nb::gil_scoped_release free;
        plant_ticks(p, duty.data(), ticks, log.data(), hall.data());
    }
    return nb::make_tuple(log.cast(), hall.cast());
}

// Field-oriented drive for tests without firmware: Eq. 18 and 20 from the true angle, torque linear in time.
void drive_torque(Plant &plant, const double *torque_fraction) {
    constexpr double third = 2.0943951023931953;
    for (size_t i = 0; i < plant.axis_count(); ++i) {
        const double u = torque_fraction[i];
        const double field = plant.motor_rad(i) + (u < 0.0 ? -1.5707963267948966 : 1.5707963267948966);
        const double phase[3] = {field + third, field - third, field};
        for (size_t k = 0; k < 3; ++k)
            plant.group(Plant::place(i).group).duty[k][Plant::place(i).lane] =
                static_cast<float>(0.5 * std::abs(u) * (1.0 + std::cos(phase[k])));
    }
}

nb::object plant_push(TestPlant &p, const Input2<double> &torque_fraction) {
    const size_t n = p.plant.axis_count(), ticks = torque_fraction.shape(0);
    if (torque_fraction.shape(1) != n) throw nb::value_error("torque_fraction: (ticks, axes)");
    auto log = new_array<double>({ticks, n, 4});
    std::vector<int32_t> hall(2 * n);
    for (size_t t = 0; t < ticks; ++t, ++p.tick) {
        drive_torque(p.plant, torque_fraction.data() + t * n);
        for (size_t g = 0; g < p.plant.group_count(); ++g) p.plant.sense(g, p.tick), p.plant.step(g);
        write_row(p.plant, log.data() + t * n * 4, hall.data());
    }
    return log.cast();
}

// Group by group, so that what is stepped stays in the cache: what the plant alone costs.
void plant_advance(TestPlant &p, uint32_t ticks) {
    nb::gil_scoped_release free;
    for (size_t g = 0; g < p.plant.group_count(); ++g)
        for (uint32_t t = 0; t < ticks; ++t) p.plant.sense(g, p.tick + t), p.plant.step(g);
    p.tick += ticks;
}

void bind_plant(nb::module_ &m) {
    nb::class_<TestPlant>(m, "Plant", "Motors, gears and hall sensors of n axes, without firmware.")
        .def(
            "__init__",
            [](TestPlant *self, Doubles plant, Doubles transmission, Input1<double> output_rad, uint64_t seed,
               const std::string &kernel, int substeps) {
                const std::vector<double> start(output_rad.data(), output_rad.data() + output_rad.size());
                new (self)
                    TestPlant{Plant(units_of(plant, transmission), start, seed, kernel.c_str(), substeps)};
            },
            nb::arg("plant"), nb::arg("transmission"), nb::arg("output_rad"), nb::arg("seed") = 0,
            nb::arg("kernel") = "", nb::arg("substeps") = 10)
        .def("run", &plant_run, nb::arg("duty"),
             "One tick for each row of duties (ticks, n, 3). Returns (ticks, n, 4): motor rad, momentum N m "
             "s, "
             "gear rad, output rad after each tick; and hall counts (ticks, n, 2) at its start.")
        .def("push", &plant_push, nb::arg("torque_fraction"),
             "Drives at 90 deg to the true rotor, Eq. 20, with a share [-1, 1] of the supply (ticks, n).")
        .def("advance", &plant_advance, nb::arg("ticks"), "Ticks with the duties as they are, without a log.")
        .def("state",
             [](TestPlant &p, size_t axis) {
                 const AxisState s = p.plant.state(axis);
                 return std::make_tuple(s.theta_rad, s.momentum_Nms, s.gear_rad, s.output_rad);
             })
        .def(
            "set_state",
            [](TestPlant &p, size_t axis, double theta_rad, double momentum_Nms, double gear_rad) {
                p.plant.set_state(axis, theta_rad, momentum_Nms, gear_rad);
            },
            nb::arg("axis"), nb::arg("theta_rad"), nb::arg("momentum_Nms"), nb::arg("gear_rad"))
        .def("set_external_torque", [](TestPlant &p, size_t axis,
                                       double torque_Nm) { p.plant.set_external_torque(axis, torque_Nm); })
        .def("backlash_rad", [](TestPlant &p, size_t axis) { return p.plant.backlash_rad(axis); })
        .def_prop_ro("kernel", [](TestPlant &p) { return p.plant.kernel_name(); });
}

// Truth of the transmission at any output angles: gear angle T- and backlash, both motor rad.
nb::tuple evaluate_transmission(const Input1<double> &row, double gear_ratio,
                                const Input1<double> &output_rad) {
    const Transmission t = transmission_of(row);
    auto gear = new_array<double>({output_rad.size()}), backlash = new_array<double>({output_rad.size()});
    for (size_t i = 0; i < output_rad.size(); ++i) {
        const Cell cell = cell_of_output(t, gear_ratio, output_rad.data()[i]);
        gear.data()[i] = gear_of_output(cell, output_rad.data()[i]);
        backlash.data()[i] = cell.backlash_0_rad + cell.backlash_1 * gear.data()[i];
    }
    return nb::make_tuple(gear.cast(), backlash.cast());
}

// --- the twin ----------------------------------------------------------------------------------

TwinSetup setup_of(const Input1<uint16_t> &ids, const Doubles &plant, const Doubles &transmission,
                   const Floats &firmware, const Rows2 &start_rad, const Rows5 &arms, const Rows5 &obstacles,
                   const std::tuple<double, double, double> &body) {
    TwinSetup s;
    s.ids.assign(ids.data(), ids.data() + ids.size());
    s.units = units_of(plant, transmission);
    s.params.resize(rows_of(firmware.size(), firmware_floats, "firmware"));
    std::memcpy(s.params.data(), firmware.data(), firmware.size() * sizeof(float));
    for (size_t i = 0; i < start_rad.shape(0); ++i)
        s.start.push_back({start_rad.data()[2 * i], start_rad.data()[2 * i + 1]});
    for (size_t i = 0; i < arms.shape(0); ++i) {
        const double *a = arms.data() + 5 * i;
        s.arms.push_back({{a[0], a[1]}, a[2], a[3], a[4]});
    }
    for (size_t i = 0; i < obstacles.shape(0); ++i) {
        const double *o = obstacles.data() + 5 * i;
        s.obstacles.push_back({{{o[0], o[1]}, {o[2], o[3]}}, o[4]});
    }
    s.body = {std::get<0>(body), std::get<1>(body), std::get<2>(body)};
    return s;
}

void twin_init(Twin *self, Input1<uint16_t> ids, Doubles plant, Doubles transmission, Floats firmware,
               Rows2 start_rad, Rows5 arms, Rows5 obstacles, std::tuple<double, double, double> body_mm,
               uint64_t seed, int threads, bool neighbours, bool skip_resting, bool side_by_side,
               int substeps, std::string kernel) {
    TwinSetup s = setup_of(ids, plant, transmission, firmware, start_rad, arms, obstacles, body_mm);
    s.seed = seed;
    s.threads = threads;
    s.neighbours = neighbours;
    s.skip_resting = skip_resting;
    s.side_by_side = side_by_side;
    s.substeps = substeps;
    s.kernel = std::move(kernel);
    new (self) Twin(s);
}

fl_can_frame_t frame_of(uint32_t id, const nb::bytes &data) {
    if (data.size() > 8) throw nb::value_error("a CAN frame carries 0 to 8 bytes");
    fl_can_frame_t frame{};
    frame.id = id;
    frame.len = static_cast<uint8_t>(data.size());
    std::memcpy(frame.data, data.c_str(), data.size());
    return frame;
}

void twin_send(Twin &twin, uint32_t id, const nb::bytes &data) { twin.send(frame_of(id, data)); }

nb::list listed(const std::vector<Reply> &replies) {
    nb::list out;
    for (const Reply &r : replies)
        out.append(nb::make_tuple(r.frame.id,
                                  nb::bytes(reinterpret_cast<const char *>(r.frame.data), r.frame.len),
                                  static_cast<double>(r.tick) * tick_s));
    return out;
}

nb::list twin_run(Twin &twin, uint64_t ticks) {
    std::vector<Reply> replies;
    {
        nb::gil_scoped_release free;
        replies = twin.run(ticks);
    }
    return listed(replies);
}

nb::object twin_outputs(Twin &twin) {
    auto out = new_array<double>({twin.positioner_count(), 2});
    for (size_t i = 0; i < twin.positioner_count(); ++i) {
        const fl::Angles a = twin.output(i);
        out.data()[2 * i] = a.alpha_rad;
        out.data()[2 * i + 1] = a.beta_rad;
    }
    return out.cast();
}

nb::object twin_motors(Twin &twin) {
    auto out = new_array<double>({twin.positioner_count(), 2});
    for (size_t axis = 0; axis < 2 * twin.positioner_count(); ++axis)
        out.data()[axis] = twin.plant().motor_rad(axis);
    return out.cast();
}

nb::object twin_scope(Twin &twin, size_t index, int axis) {
    const std::vector<ScopeSample> samples = twin.take_scope(index, axis);
    constexpr size_t columns = sizeof(ScopeSample) / sizeof(double);
    auto out = new_array<double>({samples.size(), columns});
    if (!samples.empty()) std::memcpy(out.data(), samples.data(), samples.size() * sizeof(ScopeSample));
    return out.cast();
}

nb::list twin_touches(Twin &twin) {
    nb::list out;
    for (const Touch &t : twin.take_touches())
        out.append(nb::make_tuple(static_cast<double>(t.tick) * tick_s, t.first, t.second));
    return out;
}

void check_axis(int axis) {
    if (axis < 0 || axis >= FL_AXES) throw nb::value_error("axis: 0 (alpha) or 1 (beta)");
}

void twin_fault(Twin &twin, size_t index, int axis, const std::string &kind, bool on) {
    check_axis(axis);
    PositionerFaults f = twin.faults(index);
    if (kind == "dead")
        f.axes[axis].dead = on;
    else if (kind == "blocked")
        f.axes[axis].blocked = on;
    else if (kind == "lying")
        f.axes[axis].lying = on;
    else if (kind == "stuck_hall")
        f.stuck_hall[axis] = on;
    else if (kind == "deaf")
        f.deaf = on;
    else if (kind == "mute")
        f.mute = on;
    else
        throw nb::value_error(("unknown fault '" + kind + "'").c_str());
    twin.set_faults(index, f);
}

void twin_slip(Twin &twin, size_t index, int axis, double up, double down) {
    check_axis(axis);
    PositionerFaults f = twin.faults(index);
    f.axes[axis].follows_up = up;
    f.axes[axis].follows_down = down;
    twin.set_faults(index, f);
}

void bind_whole_twin(nb::module_ &m) {
    nb::class_<Twin>(m, "Twin", "Positioners with firmware on a virtual bus.")
        .def("__init__", &twin_init, nb::kw_only(), nb::arg("ids"), nb::arg("plant"), nb::arg("transmission"),
             nb::arg("firmware"), nb::arg("start_rad"), nb::arg("arms"), nb::arg("obstacles"),
             nb::arg("body_mm"), nb::arg("seed"), nb::arg("threads"), nb::arg("neighbours"),
             nb::arg("skip_resting"), nb::arg("side_by_side"), nb::arg("substeps"), nb::arg("kernel"))
        .def("send", &twin_send, nb::arg("id"), nb::arg("data"))
        .def("connect", &Twin::connect, nb::arg("index"), nb::arg("bus"))
        .def("run", &twin_run, nb::arg("ticks"), "Replies (id, data, time_s) since the last call.")
        .def("outputs_rad", &twin_outputs)
        .def("motors_rad", &twin_motors)
        .def("scope", [](Twin &t, size_t i, int axis, bool on) { check_axis(axis), t.scope(i, axis, on); })
        .def("take_scope",
             [](Twin &t, size_t i, int axis) { return check_axis(axis), twin_scope(t, i, axis); })
        .def("take_touches", &twin_touches)
        .def("fault", &twin_fault, nb::arg("index"), nb::arg("axis"), nb::arg("kind"), nb::arg("on"))
        .def("slip", &twin_slip, nb::arg("index"), nb::arg("axis"), nb::arg("up"), nb::arg("down"),
             "Share of the gear's way that the arm makes, upwards and downwards; 1 and 1: no fault.")
        .def("power_cycle", &Twin::power_cycle, nb::arg("index"), nb::arg("bootloader") = false)
        .def("set_external_torque",
             [](Twin &t, size_t i, int axis, double torque_Nm) {
                 check_axis(axis), t.set_external_torque(i, axis, torque_Nm);
             })
        .def("set_transmission",
             [](Twin &t, size_t i, int axis, const Input1<double> &row) {
                 check_axis(axis), t.set_transmission(i, axis, transmission_of(row));
             })
        .def("set_params",
             [](Twin &t, size_t i, int axis, const Input1<double> &row) {
                 check_axis(axis), t.set_params(i, axis, params_of(row));
             })
        .def("backlash_rad",
             [](Twin &t, size_t i, int axis) {
                 return t.plant().backlash_rad(2 * i + static_cast<size_t>(axis));
             })
        .def("asleep", &Twin::asleep)
        .def_prop_ro("resting", &Twin::resting)
        .def_prop_ro("bytes_per_positioner", &Twin::bytes_per_positioner,
                     "Memory of one positioner beside its firmware's state, before any log.")
        .def_prop_ro("tick", &Twin::tick)
        .def_prop_ro("ticks_run", &Twin::ticks_run)
        .def_prop_ro("ticks_skipped", &Twin::ticks_skipped)
        .def_prop_ro("kernel", [](Twin &t) { return t.kernel_name(); });
}

nb::dict pace_of(const RealTime &real) {
    const Pace pace = real.pace();
    nb::dict d;
    d["ticks_busy"] = pace.busy.ticks();
    d["ticks_kept"] = pace.busy.kept();
    d["ticks_resting"] = pace.resting;
    d["late_p50_s"] = pace.busy.quantile_s(0.5);
    d["late_p99_s"] = pace.busy.quantile_s(0.99);
    d["late_worst_s"] = pace.busy.worst_s();
    d["given_up_s"] = pace.given_up_s;
    return d;
}

void real_time_post(RealTime &real,
                    const std::vector<std::tuple<uint32_t, nb::bytes, int, uint64_t>> &frames) {
    std::vector<QueuedFrame> queued;
    for (const auto &[id, data, bus, tick] : frames) queued.push_back({frame_of(id, data), bus, tick});
    real.post(queued);
}

void bind_real_time(nb::module_ &m) {
    nb::class_<RealTime>(m, "RealTime", "A thread that computes each tick of a Twin when it is due.")
        .def(nb::init<Twin &, double, int>(), nb::arg("twin"), nb::arg("speed"), nb::arg("wake_fd"),
             nb::keep_alive<1, 2>())
        .def("post", &real_time_post, nb::arg("frames"), "Frames (id, data, bus, tick).")
        .def("take", [](RealTime &r) { return listed(r.take()); })
        .def_prop_ro("tick_now", &RealTime::tick_now)
        .def("pace", &pace_of)
        .def("hold", &RealTime::hold, nb::call_guard<nb::gil_scoped_release>())
        .def("release", &RealTime::release)
        .def("go_first", &RealTime::go_first)
        .def("stop", &RealTime::stop, nb::call_guard<nb::gil_scoped_release>());
}

} // namespace

void bind_twin(nb::module_ &m) {
    nb::module_ t =
        m.def_submodule("twin", "Physics of whole focal planes with firmware in the loop. SI, rad.");
    t.attr("PLANT_PARAMS") = plant_params();
    t.attr("KERNELS") = kernel_list();
    t.attr("HARMONIC_ORDERS") = nb::cast(std::vector<int>(harmonic_orders.begin(), harmonic_orders.end()));
    t.attr("WEAR_COUNT") = wear_count;
    t.attr("TRANSMISSION_SIZE") = transmission_doubles;
    t.attr("NODES_PER_TURN") = nodes_per_turn;
    t.attr("TICK_S") = tick_s;
    t.attr("SYNC_TICKS") = sync_ticks;
    t.attr("SCOPE_FIELDS") = nb::make_tuple(
        "time_s", "motor_rad", "gear_rad", "output_rad", "speed_rad_s", "torque_out_Nm", "duty_a", "duty_b",
        "duty_c", "hall_a_cnt", "hall_b_cnt", "command_deg", "tracking_deg", "command_speed_rad_s",
        "feedback_Nm", "feedforward_Nm", "voltage", "load_Nm", "touch_Nm");
    t.def("transmission", &evaluate_transmission, nb::arg("transmission"), nb::arg("gear_ratio"),
          nb::arg("output_rad"), "Gear angle T- and backlash B, motor rad, at output angles.");
    bind_plant(t);
    bind_whole_twin(t);
    bind_real_time(t);
}
