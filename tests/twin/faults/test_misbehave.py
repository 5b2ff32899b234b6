"""`--faults` of `fiberloom twin`, and where its devices listen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.twin.faults.schedule import KINDS, troubles_of
from fiberloom.twin.server.server import Address, addresses_of, bus_of, device_count, places_of

IDS = [3, 5, 8, 13, 21]
PLACES = [(0, 1), (0, 2), (1, 1)]


def read(text, seed=0):
    return troubles_of(text, IDS, PLACES, seed)


def test_who_what_and_when():
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
    # who is named is not drawn again
    assert len({t.positioner_id for t in read("lying=#8,dead=4")}) == 5


@pytest.mark.parametrize(
    "text",
    [
        "frobnicate=1",
        "lying=6",
        "lying=#4",
        "lying=1.5",
        "busoff=4",
        "busoff=#3",
        "lost=2",
        "late=0.1:x",
        "powercut=1@",
        "dark=1",
        "lying=1..2",
        "=3",
        "lying=1@2@3",
    ],
)
def test_nonsense_is_named(text):
    with pytest.raises(InputError, match="--faults"):
        read(text)


@given(
    st.text("abcdefgilnoprstuwyk_=#@+:.,0123456789", max_size=30)
    | st.sampled_from(KINDS).map("{}=1@2+3".format)
)
def test_any_text_is_read_or_refused_in_one_line(text):
    try:
        said = [t.kind for t in read(text)]
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    assert isinstance(said, str) or set(said) <= set(KINDS)


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
