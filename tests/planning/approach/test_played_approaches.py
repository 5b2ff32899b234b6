"""Approaches of single positioners, played by the firmware on the twin."""

import numpy as np
from made import bare, facing

from fiberloom.bus.identifier import encode
from fiberloom.bus.protocol import Command
from fiberloom.planning import plan
from fiberloom.studies.legal_moves import upload
from fiberloom.twin import Twin, draw_units

BLIND_DEG = 0.05
"""What maps that are right leave of a blind move; a backlash that is not closed is 0.2 deg."""
LATE_S = 0.1
"""So much later than in the plan all begins: the first point is where they are."""


def wire_path(units, row, axis, robot):
    """One axis of a trajectory as (s, deg) on the wire, by the true gear; equal angles may follow."""
    angles_deg = robot.points_deg[:, axis]
    wire_deg = units.transmission(row, axis, angles_deg)[0]
    return [(LATE_S + float(t), float(x)) for t, x in zip(robot.time_s, wire_deg, strict=True)]


def test_the_firmware_comes_down_as_the_plan_tells_and_touches_nothing():
    """Lower, later or one axis after the other."""
    plane, own, worst_deg = bare(2), 0, []
    units = draw_units(plane, 3)
    for goal_deg in facing(1)[:6]:
        made = plan(plane, plane.park_deg, goal_deg)
        own += len(made.approaches)
        twin = Twin(plane, units, seed=1, threads=1, start_deg=plane.park_deg)
        upload(
            twin,
            {
                robot.positioner_id: [wire_path(units, row, axis, robot) for axis in (0, 1)]
                for row, robot in enumerate(made.robots)
            },
        )
        twin.send([(encode(0, Command.START_TRAJECTORY, 1), b"")])
        twin.run(made.duration_s + 2.0)
        assert twin.touches() == []
        worst_deg.append(float(np.abs(twin.truth() - made.end_deg).max()))
    print(f"{own} own approaches, blind errors of the arms at most {max(worst_deg):.3f} deg")
    assert max(worst_deg) < BLIND_DEG
    assert own >= 6
