"""Contacts in the truth of the twin, against a dense search by other geometry."""

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from fiberloom.drive.desi import DesiCommand, DesiFrame, move_tables
from fiberloom.drive.desi.frames import POSITIONERS, rows_of, table_frames
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.contacts import line_gap_mm, parts_of, separation_mm

RUN = DesiFrame.of(POSITIONERS, DesiCommand.RUN, b"\x01")


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("desi"), seed=0, n_positioners=60)


def started(twin, tables):
    ids = twin.plane.positioner_id.tolist()
    twin.send([f for row, k in enumerate(ids) for f in table_frames(k, rows_of(tables, row))])
    twin.send([RUN])
    return float(tables.duration_s.max())


def crossing(first, second):
    """Whether outlines (k,) and (l,) of complex corners overlap: a corner inside, or sides that cross."""
    for one, other in ((first.real, second.real), (first.imag, second.imag)):
        if one.max() < other.min() or other.max() < one.min():
            return False
    as_path = [Outline(np.column_stack([z.real, z.imag])) for z in (first, second)]
    inside = any(
        path.contains_points(np.column_stack([z.real, z.imag])).any()
        for path, z in zip(as_path, (second, first), strict=True)
    )
    a, b = first[:, None], np.roll(first, -1)[:, None]
    c, d = second[None], np.roll(second, -1)[None]

    def side(p, q, r):
        return np.imag(np.conj(q - p) * (r - p))

    cross = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return inside or bool(cross.any())


def touching_at(twin, angles_deg):
    """Pairs of rows whose phi-phi or phi-theta outlines overlap."""
    arms, parts = twin.units.arms, parts_of(twin.plane)
    alpha = np.deg2rad(angles_deg[:, 0]) + arms[:, 3]
    beta = alpha + np.deg2rad(angles_deg[:, 1]) + arms[:, 4]
    centre = arms[:, 0] + 1j * arms[:, 1]
    elbow = centre + arms[:, 2] * np.exp(1j * alpha)
    placed = {p.arm: p.placed(elbow, beta) if p.arm else p.placed(centre, alpha) for p in parts}
    found = set()
    for i in range(len(arms)):
        for j in range(i + 1, len(arms)):
            if abs(centre[i] - centre[j]) > 15.0:
                continue
            kinds = ((1, 1), (1, 0), (0, 1))
            if any(crossing(placed[a][i], placed[b][j]) for a, b in kinds):
                found.add((i, j))
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_contacts_are_those_of_a_dense_search(plane, seed):
    rng = np.random.default_rng(seed)
    twin = DesiTwin(plane, seed=seed)
    ways = np.stack([rng.uniform(-150, 150, (60, 2)), rng.uniform(-170, -20, (60, 2))], axis=2)
    ways[:, 1, 1] *= -0.5
    end_s = started(twin, move_tables(ways))
    path, told = twin._running[0][2], twin.touches()
    found = {(touch.positioner_id, touch.other) for touch in told if touch.other is not None}
    ids, rows, dense = plane.positioner_id, np.arange(60), set()
    for time in np.linspace(0.0, end_s, 250):
        at, _ = path.output_deg(rows, np.full(60, time))
        dense |= {(int(ids[i]), int(ids[j])) for i, j in touching_at(twin, at)}
    assert len(dense) > 3
    assert dense <= found
    # the search may know of grazes between the moments of the dense one
    for touch in told:
        if touch.other is not None:
            at, _ = path.output_deg(rows, np.full(60, touch.time_s))
            pair = tuple(sorted(plane.index_of([touch.positioner_id, touch.other]).tolist()))
            assert pair in touching_at(twin, at)


def test_folded_arms_may_turn_as_they_like(plane):
    twin = DesiTwin(plane, seed=0)
    started(twin, move_tables(np.column_stack([np.linspace(-150, 150, 60), np.zeros(60)])))
    assert twin.touches() == []


def test_gaps_by_hand():
    square = np.array([[0, 1, 1 + 1j, 1j]], dtype=complex)
    assert separation_mm(square, square + 3.0)[0] == pytest.approx(2.0)
    assert separation_mm(square, square + 0.25)[0] == pytest.approx(-0.75)
    # a line past a corner, through the square, and a disc's centre
    told = [(2.0 + 0j, 2.0 + 5j), (-1 + 0.5j, 2 + 0.5j), (4 + 5j, 4 + 5j), (0.5 + 0.5j, 0.5 + 0.5j)]
    gaps = [line_gap_mm(square, np.array([a]), np.array([b]))[0] for a, b in told]
    assert gaps[0] == pytest.approx(1.0)
    assert gaps[1] < 0.0
    assert gaps[2] == pytest.approx(5.0)
    assert gaps[3] == pytest.approx(-0.5)


def test_what_touches_already_is_told_once(plane):
    """Arms that cross, and then move on across each other: one contact, when it came about."""
    folded = np.tile([0.0, 180.0], (60, 1))
    rng = np.random.default_rng(1)
    out = np.stack([rng.uniform(-150, 150, (60, 1)), rng.uniform(-170, -150, (60, 1))], axis=2)
    twin = DesiTwin(plane, seed=1, start_deg=folded)
    twin.execute(move_tables(out))
    pairs = touching_at(twin, twin.truth())
    first = twin.touches()
    assert len(pairs) > 0
    twin.execute(move_tables(np.full((60, 1, 2), -0.01)))
    again = {(t.positioner_id, t.other) for t in twin.touches()}
    stand = {tuple(plane.positioner_id[list(pair)].tolist()) for pair in pairs}
    assert stand <= {(t.positioner_id, t.other) for t in first}
    assert not stand & again
