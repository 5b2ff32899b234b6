"""Positioners that land in the same tick: a served twin has half a millisecond for each."""

import struct

from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.units import COUNTS_PER_DEG, TICK_S

NEW, POINT, END, START = 10, 11, 12, 14
PLANE = generate(load_instrument("sdssv"), seed=1, n_positioners=48)
HERE_DEG, THERE_DEG, TIMES_S = (10.0, 170.0), (12.0, 172.0), (0.1, 0.5)


def test_all_that_land_together_do_not_come_back_from_the_lanes_together():
    twin = Twin(PLANE, draw_units(PLANE, seed=1), seed=1, threads=1, start_deg=HERE_DEG, neighbours=False)
    for number in map(int, PLANE.positioner_id):
        frames = [(encode(number, NEW, 1), struct.pack("<II", 2, 2))]
        for goals_deg in zip(HERE_DEG, THERE_DEG, strict=True):
            for goal_deg, time_s in zip(goals_deg, TIMES_S, strict=True):
                point = struct.pack("<iI", int(goal_deg * COUNTS_PER_DEG), int(time_s / TICK_S))
                frames.append((encode(number, POINT, 1), point))
        twin.send([*frames, (encode(number, END, 1), b"")])
    twin.run(0.1)
    twin.send([(encode(0, START, 0), b"")])
    single = []
    for _ in range(2000):
        twin.run(TICK_S)
        single.append(twin._core.single_ticks)
    landing = round(TIMES_S[1] / TICK_S)
    assert max(single[landing - 5 : landing + 5]) == 48  # from the path into the landing
    assert 0 < max(single[landing + 10 : landing + 120]) <= 12
