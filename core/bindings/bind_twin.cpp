// The whole twin, and the twin against the wall clock.
#include <map>

#include "fiberloom/twin/real_time.hpp"
#include "fiberloom/twin/twin.hpp"
#include "twin_rows.hpp"

namespace {

using namespace fl::twin;
using Floats = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Rows2 = Input<double, -1, 2>;
using Rows5 = Input<double, -1, 5>;

constexpr size_t firmware_floats = sizeof(fl_axis_params_t) / sizeof(float);
constexpr nb::ssize_t scope_columns = static_cast<nb::ssize_t>(scope_field_count);

void setup_init(TwinSetup *self, Input1<uint16_t> ids, Doubles plant, Doubles transmission, Floats firmware,
                Rows2 start_rad) {
    TwinSetup s;
    s.ids.assign(ids.data(), ids.data() + ids.size());
    s.units = units_of(plant, transmission);
    s.params.resize(rows_of(firmware.size(), firmware_floats, "firmware"));
    std::memcpy(s.params.data(), firmware.data(), firmware.size() * sizeof(float));
    for (size_t i = 0; i < start_rad.shape(0); ++i)
        s.start.push_back({start_rad.data()[2 * i], start_rad.data()[2 * i + 1]});
    new (self) TwinSetup(std::move(s));
}

void setup_place(TwinSetup &s, Rows5 arms, Rows5 obstacles, std::tuple<double, double, double> body_mm) {
    s.arms.clear();
    s.obstacles.clear();
    for (size_t i = 0; i < arms.shape(0); ++i) {
        const double *a = arms.data() + 5 * i;
        s.arms.push_back({{a[0], a[1]}, a[2], a[3], a[4]});
    }
    for (size_t i = 0; i < obstacles.shape(0); ++i) {
        const double *o = obstacles.data() + 5 * i;
        s.obstacles.push_back({{{o[0], o[1]}, {o[2], o[3]}}, o[4]});
    }
    s.body = {std::get<0>(body_mm), std::get<1>(body_mm), std::get<2>(body_mm)};
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

// Identifier, data, virtual time in s.
using Replies = nb::typed<nb::list, std::tuple<uint32_t, nb::bytes, double>>;

Replies listed(const std::vector<Reply> &replies) {
    Replies out;
    for (const Reply &r : replies)
        out.append(nb::make_tuple(r.frame.id,
                                  nb::bytes(reinterpret_cast<const char *>(r.frame.data), r.frame.len),
                                  static_cast<double>(r.tick) * tick_s));
    return out;
}

Replies twin_run(Twin &twin, uint64_t ticks) {
    std::vector<Reply> replies;
    {
        nb::gil_scoped_release free;
        replies = twin.run(ticks);
    }
    return listed(replies);
}

Replies twin_run_until_reply(Twin &twin, uint64_t ticks, uint64_t slices) {
    std::vector<Reply> replies;
    {
        nb::gil_scoped_release free;
        replies = twin.run_until_reply(ticks, slices);
    }
    return listed(replies);
}

Output<double, -1, 2> twin_outputs(Twin &twin) {
    auto out = new_array<double, -1, 2>({twin.positioner_count(), 2});
    for (size_t i = 0; i < twin.positioner_count(); ++i) {
        const fl::Angles a = twin.output(i);
        out.data()[2 * i] = a.alpha_rad;
        out.data()[2 * i + 1] = a.beta_rad;
    }
    return out;
}

Output<double, -1, 2> twin_motors(Twin &twin) {
    auto out = new_array<double, -1, 2>({twin.positioner_count(), 2});
    for (size_t axis = 0; axis < 2 * twin.positioner_count(); ++axis)
        out.data()[axis] = twin.plant().motor_rad(axis);
    return out;
}

Output<double, -1, scope_columns> twin_scope(Twin &twin, size_t index, int axis) {
    const std::vector<ScopeSample> samples = twin.take_scope(index, axis);
    auto out = new_array<double, -1, scope_columns>({samples.size(), scope_field_count});
    if (!samples.empty()) std::memcpy(out.data(), samples.data(), samples.size() * sizeof(ScopeSample));
    return out;
}

// Virtual time in s, row of the positioner, row of the other; from the number of positioners on: an obstacle.
using Touches = nb::typed<nb::list, std::tuple<double, uint32_t, uint32_t>>;

Touches twin_touches(Twin &twin) {
    Touches out;
    for (const Touch &t : twin.take_touches())
        out.append(nb::make_tuple(static_cast<double>(t.tick) * tick_s, t.first, t.second));
    return out;
}

void check_axis(int axis) {
    if (axis < 0 || axis >= FL_AXES) throw nb::value_error("axis: 0 (alpha) or 1 (beta)");
}

// Any other than the one named stays when that one is taken away.
bool at_start(PositionerFaults &f, const std::string &kind, bool on) {
    static const std::map<std::string, AtStart> kinds = {
        {"nostart", AtStart::misses}, {"refuse", AtStart::refuses}, {"reboot", AtStart::restarts}};
    const auto found = kinds.find(kind);
    if (found == kinds.end()) return false;
    if (on)
        f.at_start = found->second;
    else if (f.at_start == found->second)
        f.at_start = AtStart::obeys;
    return true;
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
    else if (!at_start(f, kind, on))
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

void twin_scope_on(Twin &twin, size_t index, int axis, bool on) {
    check_axis(axis);
    twin.scope(index, axis, on);
}

void twin_torque(Twin &twin, size_t index, int axis, double torque_Nm) {
    check_axis(axis);
    twin.set_external_torque(index, axis, torque_Nm);
}

AxisLoad load_of(const double *row) { return {row[0], row[1], row[2], row[3], row[4], row[5]}; }

void twin_loads(Twin &twin, const Input<double, -1, 12> &rows) {
    if (rows.shape(0) != twin.positioner_count()) throw nb::value_error("loads: a row for every positioner");
    for (size_t i = 0; i < rows.shape(0); ++i) {
        const double *row = rows.data() + 12 * i;
        twin.set_loads(i, load_of(row), load_of(row + 6));
    }
}

void twin_transmission(Twin &twin, size_t index, int axis, const Input1<double> &row) {
    check_axis(axis);
    twin.set_transmission(index, axis, transmission_of(row));
}

void twin_params(Twin &twin, size_t index, int axis, const Input1<double> &row) {
    check_axis(axis);
    twin.set_params(index, axis, params_of(row));
}

Output<double, -1> twin_bounds(Twin &twin, uint64_t ticks) {
    const std::vector<double> bounds = twin.bounds_mm(ticks);
    auto out = new_array<double, -1>({bounds.size()});
    std::copy(bounds.begin(), bounds.end(), out.data());
    return out;
}

double twin_backlash(Twin &twin, size_t index, int axis) {
    check_axis(axis);
    if (index >= twin.positioner_count()) throw nb::index_error("no such positioner");
    return twin.plant().backlash_rad(2 * index + static_cast<size_t>(axis));
}

void bind_setup(nb::module_ &m) {
    nb::class_<TwinSetup>(m, "TwinSetup", "What a twin is made from, N positioners.")
        .def(
            "__init__", &setup_init, nb::kw_only(), nb::arg("ids"), nb::arg("plant"), nb::arg("transmission"),
            nb::arg("firmware"), nb::arg("start_rad"),
            "ids (N,), 1..2047; rows of alpha and beta in turn: plant (2 N, len(PLANT_PARAMS)), transmission "
            "(2 N, TRANSMISSION_SIZE), firmware (2 N, len(AXIS_PARAMS)); start_rad (N, 2), output angles.")
        .def("place", &setup_place, nb::arg("arms"), nb::arg("obstacles"), nb::arg("body_mm"),
             "arms (N, 5): centre x, y, l_alpha in mm, alpha_off, beta_off in rad; obstacles (K, 5): x0, y0, "
             "x1, y1, radius in mm; body_mm: centre line of a beta arm from x0 to x1, and its radius.")
        .def_rw("seed", &TwinSetup::seed)
        .def_rw("threads", &TwinSetup::threads)
        .def_rw("neighbours", &TwinSetup::neighbours, "arms that touch push each other")
        .def_rw("skip_resting", &TwinSetup::skip_resting, "leave out what would change nothing")
        .def_rw("side_by_side", &TwinSetup::side_by_side, "laws of several axes at once; the same bits")
        .def_rw("sort_lanes", &TwinSetup::sort_lanes,
                "at START positioners whose ways end about together are stepped together; the same bytes")
        .def_prop_rw(
            "substeps", [](const TwinSetup &s) { return std::pair(s.substeps.all, s.substeps.pushing); },
            [](TwinSetup &s, const SubstepsArgument &substeps) { s.substeps = substeps_of(substeps); },
            "of the plant in a tick: of any axis, and of one that pushes its gear all the time; one number "
            "for "
            "both")
        .def_rw("kernel", &TwinSetup::kernel, "one of KERNELS, or empty for the best")
        .def_rw("bound_scale", &TwinSetup::bound_scale,
                "of how far arms may come until they are looked at again: above 1 shorter slices, the same "
                "bytes");
}

void bind_readings(nb::class_<Twin> &twin) {
    twin.def("outputs_rad", &twin_outputs, "Output angles (N, 2).")
        .def("motors_rad", &twin_motors, "Motor angles (N, 2).")
        .def("scope", &twin_scope_on, nb::arg("index"), nb::arg("axis"), nb::arg("on"),
             "Records an axis in every tick from now on, or no longer.")
        .def("take_scope", &twin_scope, nb::arg("index"), nb::arg("axis"),
             "Rows of SCOPE_FIELDS since the last call.")
        .def("take_touches", &twin_touches, "First moments of contact since the last call.")
        .def("backlash_rad", &twin_backlash, nb::arg("index"), nb::arg("axis"),
             "Where the gear is, motor rad.")
        .def("asleep", &Twin::asleep, nb::arg("index"))
        .def_prop_ro("resting", &Twin::resting)
        .def_prop_ro("bytes_per_positioner", &Twin::bytes_per_positioner,
                     "Memory of one positioner beside its firmware's state, before any log.")
        .def_prop_ro("tick", &Twin::tick)
        .def_prop_ro("ticks_run", &Twin::ticks_run)
        .def_prop_ro("single_ticks", &Twin::single_ticks)
        .def_prop_ro("ticks_skipped", &Twin::ticks_skipped)
        .def_prop_ro("group_ticks", &Twin::group_ticks,
                     "Ticks of groups of lanes in which one of their positioners was awake.")
        .def_prop_ro("slices", &Twin::slices, "Spans of time in which threads did not wait for each other.")
        .def("bounds_mm", &twin_bounds, nb::arg("ticks"),
             "The farthest (N,) that arms can come within 4 to 256 ticks from now, unless one begins to push "
             "another.")
        .def_prop_ro("kernel", [](Twin &t) { return std::string(t.kernel_name()); });
}

void bind_whole_twin(nb::module_ &m) {
    nb::class_<Twin> twin(m, "Twin", "Positioners with firmware on a virtual bus.");
    twin.def(nb::init<const TwinSetup &>(), nb::arg("setup"), "ValueError where the setup is not sound.")
        .def("send", &twin_send, nb::arg("id"), nb::arg("data"))
        .def("connect", &Twin::connect, nb::arg("index"), nb::arg("bus"))
        .def("run", &twin_run, nb::arg("ticks"), "Replies (id, data, time_s) since the last call.")
        .def("run_until_reply", &twin_run_until_reply, nb::arg("ticks"), nb::arg("slices"),
             "So many slices of ticks, none after one that has brought replies (id, data, time_s).")
        .def("fault", &twin_fault, nb::arg("index"), nb::arg("axis"), nb::arg("kind"), nb::arg("on"),
             "kind: dead, blocked, lying, stuck_hall, deaf or mute.")
        .def("slip", &twin_slip, nb::arg("index"), nb::arg("axis"), nb::arg("up"), nb::arg("down"),
             "Share of the gear's way that the arm makes, upwards and downwards; 1 and 1: no fault.")
        .def("power_cycle", &Twin::power_cycle, nb::arg("index"), nb::arg("bootloader") = false)
        .def("set_temperature", &Twin::set_temperature, nb::arg("index"), nb::arg("counts"),
             "What the temperature sensor of a positioner reads, in the sensor's counts.")
        .def("power_up", &Twin::power_up, nb::arg("index"), nb::arg("alpha_turns"), nb::arg("beta_turns"),
             "Power off and on at rest, no datum on record, counters off by so many whole motor turns.")
        .def("set_external_torque", &twin_torque, nb::arg("index"), nb::arg("axis"), nb::arg("torque_Nm"))
        .def("set_loads", &twin_loads, nb::arg("rows"),
             "(N, 12): of alpha, then of beta moment_x and moment_y (kg m, in the frame of the arm), "
             "fibre_rate (Nm/rad), fibre_free (rad), fibre_friction (Nm), fibre_slip (rad).")
        .def(
            "point", [](Twin &t, double x, double y) { t.point({x, y}); }, nb::arg("x_m_s2"),
            nb::arg("y_m_s2"), "Gravity along the focal plane from now on.")
        .def("set_transmission", &twin_transmission, nb::arg("index"), nb::arg("axis"), nb::arg("row"))
        .def("set_params", &twin_params, nb::arg("index"), nb::arg("axis"), nb::arg("row"));
    bind_readings(twin);
}

using Dict = nb::typed<nb::dict, nb::str, nb::any>;

nb::dict by_cause(const LateCounts &counts) {
    nb::dict found;
    for (size_t k = 0; k < late_causes; ++k) found[late_names[k]] = counts[k];
    return found;
}

// Half, 99 % and the longest of them.
std::vector<double> spread_of(const Lateness &times) {
    return {times.quantile_s(0.5), times.quantile_s(0.99), times.worst_s()};
}

// (due s, late ms, computing ms, cause, core, heard, single) of each.
nb::list late_ticks_of(const Pace &pace) {
    nb::list found;
    for (const LateTick &t : pace.ticks)
        found.append(nb::make_tuple(t.due_s, 1e3 * t.late_s, 1e3 * t.computing_s,
                                    late_names[static_cast<size_t>(t.cause)], t.core, t.heard, t.single));
    return found;
}

Dict pace_of(const RealTime &real) {
    const Pace pace = real.pace();
    Dict d;
    d["ticks_busy"] = pace.busy.ticks();
    d["ticks_kept"] = pace.busy.kept();
    d["ticks_resting"] = pace.resting;
    d["late_p50_s"] = pace.busy.quantile_s(0.5);
    d["late_p99_s"] = pace.busy.quantile_s(0.99);
    d["late_worst_s"] = pace.busy.worst_s();
    d["given_up_s"] = pace.given_up_s;
    d["late_by_cause"] = by_cause(pace.late);
    d["first_by_cause"] = by_cause(pace.first);
    d["late_ticks"] = late_ticks_of(pace);
    d["woken_s"] = spread_of(pace.woken);
    d["computing_s"] = spread_of(pace.computing);
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
        .def(nb::init<Twin &, double, int, bool>(), nb::arg("twin"), nb::arg("speed"), nb::arg("wake_fd"),
             nb::arg("first") = false, nb::keep_alive<1, 2>())
        .def("post", &real_time_post, nb::arg("frames"), "Frames (id, data, bus, tick).")
        .def("take", [](RealTime &r) { return listed(r.take()); })
        .def_prop_ro("tick_now", &RealTime::tick_now)
        .def("pace", &pace_of)
        .def("hold", &RealTime::hold, nb::call_guard<nb::gil_scoped_release>())
        .def("release", &RealTime::release)
        .def_prop_ro("first", &RealTime::first)
        .def("stop", &RealTime::stop, nb::call_guard<nb::gil_scoped_release>());
}

} // namespace

void bind_twin(nb::module_ &m) {
    nb::module_ t =
        m.def_submodule("twin", "Physics of whole focal planes with firmware in the loop. SI, rad.");
    t.attr("TICK_S") = tick_s;
    t.attr("SYNC_TICKS") = sync_ticks;
    t.attr("SCOPE_FIELDS") =
        nb::tuple(nb::cast(std::vector<std::string>(std::begin(scope_fields), std::end(scope_fields))));
    bind_plant(t);
    bind_setup(t);
    bind_whole_twin(t);
    bind_real_time(t);
}
