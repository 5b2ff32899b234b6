"""The fault schedule: which positioners have what, and when; and where a served twin's devices listen."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.kinds import SERVED
from fiberloom.twin.faults.schedule import ScheduledFault, schedule_faults
from fiberloom.twin.hardware import draw_faults
from fiberloom.twin.server.address import Address, addresses_of
from fiberloom.twin.server.server import bus_of, device_count, places_of

IDS = [3, 5, 8, 13, 21]
PLACES = [(0, 1), (0, 2), (1, 1)]
PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=7)


def read(text, seed=0):
    return schedule_faults(parse_faults(text, SERVED), IDS, PLACES, seed)


def test_kind_positioner_and_times():
    lying, late, cut, off, lost = read("lying=#8, late=0.25:1.5@3 ,powercut=#5@20,busoff=1@1+2,lost=0.01@0+4")
    assert (lying.kind, lying.positioner_id, lying.start_s, lying.end_s) == ("lying", 8, 0.0, np.inf)
    assert (late.share, late.late_s, late.start_s) == (0.25, 1.5, 3.0)
    assert (cut.start_s, cut.end_s) == (20.0, 21.0)
    assert (off.start_s, off.end_s) == (1.0, 3.0)
    assert off.place in PLACES
    assert (lost.share, lost.end_s) == (0.01, 4.0)
    assert [str(t) for t in (lying, lost)] == ["lying positioner 8", "lost 1 % of replies"]


def test_drawn_by_the_seed_and_each_hit_once():
    hit = [t.positioner_id for t in read("lying=2,dead=2,mute")]
    assert sorted(hit) == IDS
    assert hit == [t.positioner_id for t in read("lying=2,dead=2,mute")]
    assert len({tuple(t.positioner_id for t in read("lying=2", seed=s)) for s in range(20)}) > 5
    # one that is named is not drawn again
    assert len({t.positioner_id for t in read("lying=#8,dead=4")}) == 5


def test_the_draws_of_a_seed_stay():
    """Figures of runs that were made before this file: the same seed hits the same positioners."""
    assert [t.positioner_id for t in read("lying=2,dead,mute=#8@3+1")] == [5, 3, 8, 8]
    assert [t.place for t in read("busoff=2")] == [(0, 2), (1, 1)]
    assert read("busoff=1@4")[0] == ScheduledFault("busoff", place=(0, 2), start_s=4.0)
    assert [(str(f.kind), f.positioner_id) for f in draw_faults(PLANE, "dark=2,dead,lying=1", 5)] == [
        ("dark", 228), ("dark", 277), ("dead", 276), ("lying", 252),
    ]  # fmt: skip


def test_the_field_and_the_served_twin_draw_alike():
    ids = [int(i) for i in PLANE.positioner_id]
    text = "dead=2,lying=#277,deaf"
    served = schedule_faults(parse_faults(text, SERVED), ids, PLACES, 3)
    assert draw_faults(PLANE, text, 3) == served


@pytest.mark.parametrize(
    ("text", "words"),
    [("lying=6", "at most 5"), ("lying=#3,dead=3,mute=2", "mute=2.*at most"),
     ("lying=#4", "no such positioner in the layout, whose numbers are .* to [0-9]+$"),
     ("busoff=4", "at most 3")],
)  # fmt: skip
def test_more_than_there_are_and_unknown_ones_are_named(text, words):
    with pytest.raises(InputError, match=f"^--faults .*{words}"):
        read(text)


def test_no_positioner_that_is_offline_is_drawn():
    offline = PLANE.offline.copy()
    offline[:3] = True
    plane = replace(PLANE, offline=offline)
    hit = {f.positioner_id for f in draw_faults(plane, "dead=4", 1)}
    assert hit == set(plane.positioner_id[3:].tolist())
    with pytest.raises(InputError, match="at most 4"):
        draw_faults(plane, "dead=5", 1)


def test_addresses_of_devices():
    assert addresses_of("127.0.0.1:19228", 3) == [Address(f"127.0.0.{k}", 19228) for k in (1, 2, 3)]
    assert addresses_of("0.0.0.0:5000", 2) == [Address("0.0.0.0", 5000), Address("0.0.0.0", 5001)]
    assert addresses_of("tower.local:5000", 1) == [Address("tower.local", 5000)]
    for bad in ("127.0.0.1", ":19228", "127.0.0.1:0", "127.0.0.1:x", "127.0.0.1:65536", "host:65535"):
        with pytest.raises(InputError, match="--listen"):
            addresses_of(bad, 2)


@given(st.integers(1, 600))
def test_every_positioner_has_a_place_and_no_port_more_than_21(count):
    devices = device_count(count)
    places = places_of(count, devices)
    assert len(places) == count
    share = np.unique([bus_of(*place) for place in places], return_counts=True)[1]
    assert share.max() <= 21
    assert np.ptp(share) <= 1
