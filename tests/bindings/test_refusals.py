"""What the compiled module refuses, and that it names what is wrong."""

import numpy as np
import pytest
from units_of import gear_of, nominal, plain

from fiberloom._core import firmware, geometry, metrology, planning, twin
from fiberloom.planning.obstacles import plain_parts

ARMS = np.array([[0.0, 0.0, 7.4, 0.0, 0.0], [22.4, 0.0, 7.4, 0.0, 0.0]])
NO_OBSTACLES = np.zeros((0, 5))
TWO = np.zeros((2, 2))
THREE = np.zeros((3, 2))
TRAVEL = np.array([[-0.1, 6.4], [-0.1, 3.3]])
PARTS = plain_parts(2, (0.0, 14.7), 2.0)
NO_FIXED = np.zeros((0, 7))
BODIES = planning.Bodies(ARMS, PARTS, NO_FIXED)
ROWS = np.arange(2)
PARAMS = np.array([[row[4] for row in firmware.AXIS_PARAMS]] * 2, dtype=np.float32)


def task(start=TWO, goal=TWO, approach=2, fixed=2):
    return planning.Task(start, goal, np.zeros(approach), np.zeros(fixed, bool), TRAVEL)


def paced_rules(n):
    made = rules()
    made.set_paces(np.ones(n), np.ones(2))
    return made


def with_travels(made, n=3):
    made.set_travels(np.tile(TRAVEL, (n, 1, 1)))
    return made


def rules(start=0, goal=0, arrives=0, approach=0):
    made = planning.Rules(speed=1.0, acceleration=1.0, rounding=1e-8, travel=TRAVEL)
    made.expect(np.zeros((start, 2)), np.zeros((goal, 2)), np.ones(arrives, bool), np.zeros(approach))
    return made


def setup(ids=(1,), n_axes=2, **changes):
    made = twin.TwinSetup(
        ids=np.array(ids, np.uint16),
        plant=plain(np.repeat(nominal(), n_axes)),
        transmission=plain(np.repeat(gear_of(), n_axes)),
        firmware=np.repeat(PARAMS[:1], n_axes, axis=0),
        start_rad=np.full((len(ids), 2), 1.0),
    )
    made.place(np.repeat(ARMS[:1], len(ids), axis=0), NO_OBSTACLES, (0.0, 14.7, 1.5))
    for name, value in changes.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: task(goal=THREE), "goal: 3 rows for 2 positioners"),
        (lambda: task(approach=1), "approach: 1 rows for 2 positioners"),
        (lambda: task(fixed=3), "fixed: 3 rows for 2 positioners"),
        (lambda: task().set_sides((1.0, 0.5)), "sides: 1 or -1"),
        (
            lambda: planning.plan(
                BODIES, with_travels(task()), planning.Settings(speed=0.2, acceleration=0.8, grid=0.1)
            ),
            "travels: 3 rows for 2 positioners",
        ),
        (
            lambda: planning.verify(BODIES, [np.zeros((1, 3))] * 2, with_travels(rules())),
            "travels: 3 rows for 2 positioners",
        ),
        (
            lambda: planning.plan(
                BODIES, task(THREE, THREE, 3, 3), planning.Settings(speed=0.2, acceleration=0.8, grid=0.1)
            ),
            "start: 3 rows for 2 positioners",
        ),
        (lambda: rules(goal=2, arrives=1), "arrives: 1 rows for 2 positioners"),
        (lambda: planning.verify(BODIES, [np.zeros((1, 3))], rules()), "motions: 1 rows for 2 positioners"),
        (
            lambda: planning.verify(BODIES, [np.zeros((1, 3))] * 2, rules(start=3)),
            "start: 3 rows for 2 positioners",
        ),
        (
            lambda: planning.verify(BODIES, [np.zeros((1, 3))] * 2, rules(goal=1, arrives=1)),
            "goal: 1 rows for 2 positioners",
        ),
        (
            lambda: planning.verify(BODIES, [np.zeros((1, 3))] * 2, rules(approach=5)),
            "approach: 5 rows for 2 positioners",
        ),
        (lambda: planning.conflicts(BODIES, THREE, 0.01), "goals: 3 rows for 2"),
        (lambda: planning.static_ok(BODIES, ROWS, THREE, 0.01), "goals: 3 rows for 2"),
        (
            lambda: planning.pairs_clear(BODIES, ROWS, TWO, ROWS, THREE, 0.01),
            "pairs_clear: 3 rows for 2",
        ),
        (lambda: task().set_paces(np.ones(3), np.ones(2)), "speed: 3 rows for 2"),
        (lambda: task().set_paces(np.ones(2), np.ones(3)), "acceleration: 3 rows for 2"),
        (
            lambda: planning.verify(BODIES, [np.zeros((1, 3))] * 2, paced_rules(3)),
            "speed: 3 rows for 2 positioners",
        ),
        (lambda: planning.Bodies(ARMS, PARTS[:1], NO_FIXED), "a positioner without parts"),
        (lambda: planning.Bodies(ARMS, PARTS + np.eye(8)[0], NO_FIXED), "a part of no positioner"),
        (lambda: planning.Bodies(ARMS, PARTS * [1, 1, 1, 1, 1, 1, 1, 0], NO_FIXED), "layers: 1 to"),
        (
            lambda: planning.Bodies(ARMS, PARTS, np.array([[0, 0, 1, 0, 1, 1, 2.0]])),
            "an obstacle of no positioner",
        ),
        (lambda: planning.static_ok(BODIES, ROWS + 1, TWO, 0.01), "a goal of no positioner"),
        (lambda: geometry.forward(ARMS, TWO, THREE), "same number of rows"),
        (lambda: geometry.inverse(ARMS, TWO, TWO, THREE), r"limits: \[\[alpha_min"),
        (lambda: geometry.inverse_each(ARMS, TWO, TWO, np.zeros((3, 2, 2))), "same number of rows"),
    ],
)
def test_numbers_of_rows_that_differ(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: twin.Twin(setup(n_axes=4)), "units and params 2 N"),
        (lambda: twin.Twin(setup(threads=0)), "threads: 1 to 256"),
        (lambda: twin.Twin(setup(threads=257)), "threads: 1 to 256"),
        (lambda: twin.Twin(setup(ids=(0,))), "positioner ids: 1 to 2047"),
        (lambda: twin.Twin(setup(ids=(2048,))), "positioner ids: 1 to 2047"),
        (lambda: twin.Twin(setup(ids=(7, 7), n_axes=4)), "positioner id 7 occurs twice"),
        (lambda: twin.Twin(setup(substeps=0)), "substeps: 1 to 100000"),
        (lambda: twin.Twin(setup(substeps=100001)), "substeps: 1 to 100000"),
        (lambda: twin.Twin(setup(substeps=(10, 0))), "pushes its gear: 1 to those of any"),
        (lambda: twin.Twin(setup(substeps=(10, 11))), "pushes its gear: 1 to those of any"),
        (lambda: twin.Twin(setup(kernel="abacus")), "kernel 'abacus': this machine has baseline"),
        (lambda: twin.Twin(setup()).fault(0, 2, "dead", True), r"axis: 0 \(alpha\) or 1 \(beta\)"),
        (lambda: twin.Twin(setup()).fault(0, -1, "dead", True), r"axis: 0 \(alpha\) or 1 \(beta\)"),
        (lambda: twin.Twin(setup()).fault(0, 0, "sleepy", True), "unknown fault 'sleepy'"),
        (lambda: twin.Twin(setup()).send(0, bytes(9)), "0 to 8 bytes"),
        (lambda: twin.Twin(setup()).set_params(0, 0, np.zeros(3)), "one row of PLANT_PARAMS"),
        (lambda: twin.Twin(setup()).set_transmission(0, 0, np.zeros(3)), "one row of TRANSMISSION_SIZE"),
        (lambda: twin.Plant(np.zeros(3), np.zeros(twin.TRANSMISSION_SIZE), np.zeros(1)), "plant: rows of"),
        (
            lambda: twin.Plant(plain(nominal()), np.zeros(2 * twin.TRANSMISSION_SIZE), np.zeros(1)),
            "same number of axes",
        ),
        (
            lambda: twin.Plant(plain(nominal()), plain(gear_of()), np.zeros(2)),
            "one output angle for every axis",
        ),
    ],
)
def test_a_twin_that_cannot_be(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_no_such_positioner():
    made = twin.Twin(setup())
    for call in (
        lambda: made.connect(1, 0),
        lambda: made.asleep(1),
        lambda: made.scope(1, 0, True),
        lambda: made.backlash_rad(1, 0),
        lambda: made.power_cycle(1),
        lambda: made.set_external_torque(1, 0, 0.0),
    ):
        with pytest.raises(IndexError):
            call()


def test_no_such_axis():
    made = twin.Plant(plain(nominal()), plain(gear_of()), np.ones(1))
    for call in (
        lambda: made.state(1),
        lambda: made.set_state(1, 0.0, 0.0, 0.0),
        lambda: made.set_external_torque(1, 0.0),
        lambda: made.backlash_rad(1),
    ):
        with pytest.raises(IndexError, match="no such axis"):
            call()


CAMERA = metrology.Settings(1.0, 6e4, 6.0, 0.0)
NO_PROFILE = np.zeros(0)


@pytest.mark.parametrize(
    ("image", "fits", "message"),
    [
        (np.zeros((7, 20), np.uint16), False, "at least 8 x 8"),
        (np.zeros((20, 7), np.float32), False, "at least 8 x 8"),
        (np.zeros((20, 20), np.int16), False, "uint16, float32 or float64"),
        (np.zeros((20, 20), np.uint32), False, "uint16, float32 or float64"),
        (np.zeros((20, 20), np.uint16).T, False, "adjacent"),
    ],
)
def test_images_that_are_not_read(image, fits, message):
    with pytest.raises(ValueError, match=message):
        metrology.find_spots(image, fits, CAMERA, NO_PROFILE)


def test_a_profile_of_another_size_and_a_kind_of_spot_that_is_none():
    with pytest.raises(ValueError, match="not one that find_spots returned"):
        metrology.find_spots(np.zeros((20, 20), np.float32), False, CAMERA, np.zeros(5))
    for kind in (-1, 3):
        with pytest.raises(ValueError, match="0 Gaussian, 1 Moffat, 2 disc"):
            metrology.render_spots(np.zeros((20, 20), np.float32), np.zeros((1, 7)), kind, 4.0)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: firmware.encode_identifier(2048, 0), ValueError, "positioner must be 0..2047"),
        (lambda: firmware.encode_identifier(1, 256), ValueError, "command must be 0..255"),
        (lambda: firmware.encode_identifier(1, 1, 64), ValueError, "uid must be 0..63"),
        (lambda: firmware.encode_identifier(1, 1, 1, 16), ValueError, "code must be 0..15"),
        (lambda: firmware.encode_identifier(-1, 0), ValueError, "positioner must be 0..2047"),
        (lambda: firmware.decode_identifier(1 << 29), ValueError, "more than 29 bits"),
        (lambda: firmware.Positioner(0, PARAMS), ValueError, "id must be 1..2047"),
        (lambda: firmware.Positioner(2048, PARAMS), ValueError, "id must be 1..2047"),
        (lambda: firmware.Positioner(1, PARAMS).receive(0, bytes(9)), ValueError, "at most 8 bytes"),
        (lambda: firmware.Positioner(1, PARAMS).run(1, 2), IndexError, "axis must be 0"),
        (lambda: firmware.Positioner(1, PARAMS).run(1, -1), IndexError, "axis must be 0"),
        (lambda: firmware.Positioner(1, PARAMS).plant(0, "soul"), KeyError, "has no soul"),
    ],
)
def test_what_the_bench_refuses(call, error, message):
    with pytest.raises(error, match=message):
        call()
