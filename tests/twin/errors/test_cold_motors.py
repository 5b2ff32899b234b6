"""Motors in the cold: the torque they have left, how they follow, and when the slower speed is due."""

import dataclasses

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.instruments.model import Care
from fiberloom.studies.legal_moves import go_to
from fiberloom.studies.star_fields import stars
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.units import GEAR

PLANE = fl.FocalPlane.of("sdssv", n=37)
FULL_SPEED_RAD_S = 2000.0 * 2.0 * np.pi / 60.0


def units_at(at_C):
    return draw_units(PLANE, 0, errors=TwinErrors.of(PLANE.instrument, f"temperature,at_C={at_C:g}"))


def margin(plant):
    """(N, 2) torque at full voltage over what full speed needs: Kronig 2020, Eq. 8, 10, 17 and 19."""
    per_volt = plant["flux_linkage"] / plant["coil_resistance"]
    full_Nm = 1.5 * np.sqrt(0.75) * per_volt * plant["supply"]
    drag = plant["viscous_motor"] + plant["viscous_gear"] + 1.5 * per_volt * plant["flux_linkage"]
    need_Nm = plant["coulomb_motor"] + plant["coulomb_gear"] + drag * FULL_SPEED_RAD_S
    return full_Nm / (need_Nm + plant["cogging_2"] + plant["spring_rate"] / GEAR * plant["spring_free"])


def test_torque_is_left_20_K_colder():
    """Grease twice as stiff, and a stronger magnet brakes more; cold copper gives some of it back."""
    warm, cold = (margin(units_at(at_C).plant) for at_C in (20.0, 0.0))
    assert warm.min() > 2.2
    assert 1.7 < cold.min() < warm.min()
    copper_only = (1.0 + 0.0015 * 20.0) / (1.0 - 0.0039 * 20.0)
    assert (cold / warm).max() < copper_only


@pytest.mark.parametrize("at_C", [0.0, 40.0])
def test_a_motor_follows_at_full_speed(at_C):
    """As on docs/firmware.md: units as commissioned, grease x0.5 and x2, at most 29.6 motor degrees."""
    units = units_at(at_C)
    twin = Twin(PLANE, units, neighbours=False, start_deg=(20.0, 20.0))
    scopes = [twin.scope(row, axis) for row in range(6) for axis in (0, 1)]
    for number in PLANE.positioner_id[:6]:
        go_to(twin, int(number), [60.0, 60.0])
    twin.run(5.0)
    behind = [np.abs(scope.take()["tracking_deg"]).max() for scope in scopes]
    assert max(behind) < 30.0
    assert min(behind) > 1.0  # they have moved
    np.testing.assert_allclose(twin.truth()[:6], 60.0, atol=0.8)


def test_far_in_the_cold_the_telescope_s_speed_keeps_grease_from_looking_like_a_collision(tmp_path):
    """Grease x4.8 is beyond what the firmware learns, x3.4 is not; at 1000 rpm its drag is within it."""
    care = PLANE.instrument.care.model_dump() | {"cold": [{"below_C": 0.0, "speed_rpm": 1000.0}]}
    slow = PLANE.instrument.model_copy(update={"care": Care.model_validate(care)})
    maps = tmp_path / "maps.npz"
    fl.Field.twin(PLANE, 0, camera="noise").run.calibrate().save(maps)
    seen, slower = {}, dataclasses.replace(PLANE, instrument=slow)
    for name, plane, at_C in (("less cold", PLANE, -15), ("full", PLANE, -25), ("slow", slower, -25)):
        field = fl.Field.twin(plane, 0, camera="noise", errors=f"temperature,at_C={at_C}", calibration=maps)
        seen[name] = field.run.observe(stars(PLANE, "BOSS", 7), 0, out=tmp_path / name)
    assert margin(units_at(-25.0).plant).min() > 1.15  # it is not the torque
    assert not seen["less cold"].moves[0].interrupted
    assert seen["full"].moves[0].interrupted
    assert not seen["slow"].moves[0].interrupted
    assert seen["slow"].summary()["faults"] == {}
