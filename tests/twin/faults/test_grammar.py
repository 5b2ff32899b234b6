"""`--faults`: one grammar for every command, and the kinds that each command can act on."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.twin import draw_ailments
from fiberloom.twin.bench import bench_units
from fiberloom.twin.faults.ailments import NEVER, AilmentModel, chosen_ailments
from fiberloom.twin.faults.grammar import FaultRequest, faults_text, parse_faults
from fiberloom.twin.faults.kinds import (
    AGED,
    ANYWHERE,
    OBSERVED,
    SEEN,
    SERVED,
    SHARES,
    CameraFaultKind,
    ServiceKind,
)
from fiberloom.twin.faults.schedule import ScheduledFault, schedule_faults

DOCS = Path(__file__).resolve().parents[3] / "docs"
SECONDS = st.floats(0.0, 1e12, allow_nan=False)
TIMES = {"start_s": SECONDS, "duration_s": st.none() | SECONDS}
COUNTED = st.sampled_from([k for k in ANYWHERE.kinds if k not in SHARES])
NAMED = st.sampled_from(
    [k for k in ANYWHERE.kinds if k not in {*SHARES, ServiceKind.BUS_OFF, *CameraFaultKind}]
)
SHARE = st.floats(0.0, 1.0)
REQUESTS = st.one_of(
    st.builds(FaultRequest, COUNTED, st.integers(0, 10**12), **TIMES),
    st.builds(FaultRequest, NAMED, st.just(1), st.integers(0, 10**12), **TIMES),
    st.builds(FaultRequest, st.just("lost"), share=SHARE, **TIMES),
    st.builds(FaultRequest, st.just("late"), share=SHARE, late_s=SECONDS, **TIMES),
)


@given(st.lists(REQUESTS, max_size=4))
def test_what_is_written_is_read_again(requests):
    assert parse_faults(faults_text(requests)) == tuple(requests)


LETTERS = "abcdefgilnoprstuwyk_=#@+:., -e0123456789\n"


@given(
    st.text(LETTERS, max_size=30)
    | st.text(max_size=12)
    | st.tuples(REQUESTS.map(str), st.text(LETTERS, max_size=4)).map("".join)
)
def test_any_text_is_read_or_refused_by_naming_its_part(text):
    requests, said = read(text)
    parts = [part.strip() for part in text.split(",") if part.strip()]
    named = any(names(said, part) for part in parts)
    assert named if said else parse_faults(faults_text(requests)) == requests


def names(said, part):
    """A complaint is one line, and the middle of a long one is left out."""
    head = f"--faults {part}: "
    return said.startswith((head, " ".join(head.split())[:250]))


def read(text):
    try:
        return parse_faults(text), ""
    except InputError as error:
        return (), str(error)


@pytest.mark.parametrize(
    ("text", "request_"),
    [
        ("dead", FaultRequest("dead")),
        ("dead=", FaultRequest("dead")),
        (" dead= 3 ", FaultRequest("dead", 3)),
        ("dead=0", FaultRequest("dead", 0)),
        ("stuck_hall=#17@30", FaultRequest("stuck_hall", 1, 17, start_s=30.0)),
        ("powercut=3@20+5", FaultRequest("powercut", 3, start_s=20.0, duration_s=5.0)),
        ("lost=0.01", FaultRequest("lost", share=0.01)),
        ("late=.5", FaultRequest("late", share=0.5, late_s=1.0)),
        ("late=0.05:1.5+4", FaultRequest("late", share=0.05, late_s=1.5, duration_s=4.0)),
    ],
)
def test_what_a_part_means(text, request_):
    assert parse_faults(text) == (request_,)


def test_a_power_cut_lasts_a_second_and_other_faults_for_good():
    cut, dead, short = parse_faults("powercut@2,dead@3,dead@3+4")
    assert (cut.end_s, dead.end_s, short.end_s) == (3.0, float("inf"), 7.0)


@pytest.mark.parametrize(
    "part",
    ["frobnicate=1", "lying=1.5", "lying=#1.5", "busoff=#3", "lost=2", "lost=#1", "late=0.1:x", "late=0.1:",
     "powercut=1@", "lying=1..2", "=3", "lying=1@2@3", "lying=#", "lying=-1", "lying=1:2", "lost=0.1:2",
     "lying=1+2@3", "lying=" + "9" * 400, "lying=\u0663"],
)  # fmt: skip
def test_nonsense_is_named(part):
    with pytest.raises(InputError) as refused:
        parse_faults(f"dead=1, {part} ,mute")
    assert names(str(refused.value), part)


@pytest.mark.parametrize(
    ("reach", "part", "kinds"),
    [(OBSERVED, "late=0.1", "dark"), (OBSERVED, "friction", "stuck_hall"), (SERVED, "dark=1", "powercut"),
     (SERVED, "loose_arm", "busoff"), (AGED, "powercut=1", "broken_tooth"), (AGED, "dead", "dark")],
)  # fmt: skip
def test_a_kind_that_the_command_cannot_act_on_is_refused_with_those_that_it_can(reach, part, kinds):
    with pytest.raises(InputError, match=f"^--faults {part}: .*cannot act.*{kinds}") as refused:
        parse_faults(part, reach)
    assert all(kind in str(refused.value) for kind in reach.kinds)


@pytest.mark.parametrize("reach", [AGED])
@pytest.mark.parametrize("part", ["dark@3", "dark+3", "dark=1@0"])
def test_times_are_refused_where_there_is_no_clock(reach, part):
    with pytest.raises(InputError, match=f"^--faults {re.escape(part)}: .*no clock"):
        parse_faults(part, reach)


def test_ailments_go_to_the_first_units_in_the_order_of_the_text():
    _, units = bench_units("sdssv", 6, range(8))
    made = chosen_ailments(units, 4, "friction=1,dark=2,friction=1,slipping=#7", onset=9).table
    by_number = dict(zip(units.number.tolist(), made["kind"].tolist(), strict=True))
    assert [by_number[k] for k in range(1, 9)] == [
        "friction", "dark", "dark", "friction", "", "", "slipping", "",
    ]  # fmt: skip
    assert set(made["onset"][made["kind"] != ""]) == {9}
    assert set(made["onset"][made["kind"] == ""]) == {NEVER}
    only = draw_ailments(units, 4, AilmentModel(weights={"friction": 1.0})).table
    assert made["seizing_moves"][0] == only["seizing_moves"][0]


def test_one_that_is_named_is_not_counted_again():
    _, units = bench_units("sdssv", 6, range(4))
    made = chosen_ailments(units, 4, "dark=#1,stuck=2", onset=9).table
    assert made["kind"].tolist() == ["dark", "stuck", "stuck", ""]


def test_the_page_lists_every_kind_and_which_command_acts_on_it():
    page, _, _ = next(DOCS.rglob("faults.md")).read_text().partition("\n## The fault campaign")
    rows = re.findall(r"^\| `(\w+)` \|([^|]*)\|([^|]*)\|([^|]*)\|", page, flags=re.M)
    reaches = (OBSERVED, SERVED, AGED)
    told = {kind: tuple(bool(cell.strip()) for cell in cells) for kind, *cells in rows}
    others = set(ANYWHERE.kinds) - set(CameraFaultKind)
    assert told == {kind: tuple(kind in r.kinds for r in reaches) for kind in others}
    cameras = re.findall(r"^- `(camera_\w+)`: \w", page, flags=re.M)
    assert set(cameras) == set(CameraFaultKind)
    assert set(SEEN.kinds) == {*SERVED.kinds, *OBSERVED.kinds, *CameraFaultKind}


def test_there_is_one_camera():
    with pytest.raises(InputError, match="there is one camera"):
        schedule_faults(parse_faults("camera_hang=2@3"), [1, 2], [], 0)
    with pytest.raises(InputError, match="no positioner has it"):
        parse_faults("camera_half=#3")
    assert schedule_faults(parse_faults("camera_stale@3+4"), [1], [], 0) == [
        ScheduledFault("camera_stale", start_s=3.0, end_s=7.0)
    ]
