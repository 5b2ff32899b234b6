"""What a night does next, and the laws that it keeps whatever the queue is and however visits end."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.night.airmass import airmass, altitude_deg
from fiberloom.night.queue import FieldEntry, Queue, read_queue
from fiberloom.night.step import (
    Close,
    End,
    Expose,
    NightState,
    Park,
    Position,
    Visited,
    VisitState,
    Wait,
    field_states,
    next_step,
)

EVENING = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
DAWN_S = 8 * 3600


def at(seconds):
    return EVENING + timedelta(seconds=seconds)


def entry(name, **how):
    return FieldEntry(id=name, targets="x.csv", **{"exposure_s": 600.0, **how})


def queue(*fields, **how):
    return Queue(field=fields, **{"dawn": at(DAWN_S), **how})


A, B = entry("a"), entry("b")


def test_the_highest_priority_comes_first_then_the_queue_s_order():
    assert next_step(NightState(), queue(A, B), EVENING) == Position("a", 0, 0)
    assert next_step(NightState(), queue(A, entry("b", priority=1)), EVENING) == Position("b", 0, 0)
    soon = entry("b", not_after=at(3600))
    assert next_step(NightState(), queue(A, soon), EVENING) == Position("b", 0, 0)


def test_a_field_that_was_begun_is_finished_first():
    two = entry("b", dithers_um=((0, 0), (50, 0)))
    begun = NightState((Visited("b", 0, 0, VisitState.DONE, exposed=1),))
    assert next_step(begun, queue(A, two), at(900)) == Position("b", 0, 1)
    assert next_step(begun, queue(entry("a", priority=2), two), at(900)) == Position("a", 0, 0)


def test_exposures_one_by_one_then_the_visit_is_over():
    plan = queue(entry("a", exposures=2))
    for done, step in ((0, Expose(1)), (1, Expose(2)), (2, Close(VisitState.DONE, ""))):
        state = NightState((Visited("a", 0, 0, VisitState.READY, exposed=done),))
        assert next_step(state, plan, at(60)) == step


def test_what_an_interrupted_visit_has_exposed_counts():
    seen = (Visited("a", 0, 0, VisitState.INTERRUPTED, exposed=1), Visited("a", 0, 0, VisitState.READY))
    assert next_step(NightState(seen), queue(entry("a", exposures=2)), at(60)) == Expose(2)


def test_windows_airmass_and_dawn():
    late = queue(entry("a", not_before=at(1800)))
    assert next_step(NightState(), late, EVENING) == Wait(at(1800), "no field may be begun before")
    assert next_step(NightState(), late, at(1800)) == Position("a", 0, 0)
    over = queue(entry("a", not_after=at(3600)))
    assert next_step(NightState(), over, at(3600 - 600 - 89)) == End("nothing left that fits")
    ready = NightState((Visited("a", 0, 0, VisitState.READY),))
    assert next_step(ready, queue(A), at(DAWN_S - 600)) == Expose(1)
    assert isinstance(next_step(ready, queue(A), at(DAWN_S - 599)), Close)


def test_what_fails_again_and_again_is_given_up():
    failed = Visited("a", 0, 0, VisitState.FAILED)
    assert next_step(NightState((failed,)), queue(A, attempts=2), at(60)) == Position("a", 0, 0)
    twice = NightState((failed, failed))
    assert next_step(twice, queue(A, attempts=2), at(60)) == Park("the queue is done")
    assert field_states(twice, queue(A, attempts=2), at(60))["a"][0] is VisitState.FAILED
    interrupted = NightState((Visited("a", 0, 0, VisitState.INTERRUPTED),) * 9)
    assert next_step(interrupted, queue(A, attempts=1), at(60)) == Position("a", 0, 0)


SHORT = "34 of 499 fibres are within the requirement"


def test_a_place_with_too_few_fibres_on_target_is_made_again_later_and_at_last_exposed_but_not_done():
    ready = Visited("a", 0, 0, VisitState.READY, short=SHORT)
    plan = queue(A, B, attempts=2)
    closed = Close(VisitState.FAILED, f"{SHORT}: not exposed; made again later")
    assert next_step(NightState((ready,)), plan, at(60)) == closed
    failed = replace(ready, state=VisitState.FAILED)
    assert next_step(NightState((failed,)), plan, at(60)) == Position("b", 0, 0)
    other = Visited("b", 0, 0, VisitState.DONE, exposed=1)
    assert next_step(NightState((failed, other)), plan, at(900)) == Position("a", 0, 0)
    assert next_step(NightState((failed, other, ready)), plan, at(960)) == Expose(1)
    exposed = NightState((failed, other, replace(ready, exposed=1)))
    step = next_step(exposed, plan, at(1600))
    assert step == Close(VisitState.FAILED, f"{SHORT}: exposed, and not counted as done")
    over = exposed.with_last(replace(exposed.visits[-1], state=step.state))
    told = f"0 of 1 places done; exposed, and not counted: {SHORT}"
    assert field_states(over, plan, at(1600))["a"] == (VisitState.FAILED, told)
    assert next_step(over, plan, at(1600)) == Park("the queue is done")


def test_what_had_enough_fibres_counts_beside_what_had_not():
    two, good = entry("a", exposures=2), Visited("a", 0, 0, VisitState.INTERRUPTED, exposed=1)
    short = Visited("a", 0, 0, VisitState.READY, short=SHORT)
    assert next_step(NightState((good, short)), queue(two, attempts=1), at(900)) == Expose(2)
    after = NightState((good, replace(short, exposed=1)))
    assert isinstance(next_step(after, queue(two, attempts=1), at(1600)), Close)
    assert after.exposed(good.part) == 1


def test_a_field_that_is_taken_out_while_its_shutter_is_closed():
    ready = NightState((Visited("gone", 0, 0, VisitState.READY),))
    assert next_step(ready, queue(A), at(60)) == Close(VisitState.FAILED, "taken out of the queue")


# laws


moments = st.integers(0, DAWN_S // 60).map(lambda minutes: at(60 * minutes))
entries = st.builds(
    lambda name, priority, exposure_s, exposures, dithers, repeats, window: entry(
        name,
        priority=priority,
        exposure_s=float(exposure_s),
        exposures=exposures,
        dithers_um=[(10.0 * k, 0.0) for k in range(dithers)],
        repeats=repeats,
        **({} if window[0] == window[1] else {"not_before": min(window), "not_after": max(window)}),
    ),
    st.integers(0, 10**6).map(lambda k: f"f{k}"),
    st.integers(0, 2),
    st.sampled_from([60, 900, 3600]),
    st.integers(1, 3),
    st.integers(1, 2),
    st.integers(1, 2),
    st.tuples(moments, moments),
)
queues = st.builds(
    lambda fields, attempts: queue(*fields, attempts=attempts),
    st.lists(entries, min_size=1, max_size=4, unique_by=lambda e: e.id),
    st.integers(1, 2),
)


class Simulated:
    """A night on paper: visits last, fail and are interrupted as a list says."""

    def __init__(self, plan, fates):
        self.plan, self.fates, self.now = plan, iter(fates), EVENING
        self.state, self.exposed, self.steps = NightState(), [], []

    def go(self):
        for _ in range(2000):
            step = next_step(self.state, self.plan, self.now)
            assert step == next_step(self.state, self.plan, self.now)
            self.steps.append((self.now, step))
            if isinstance(step, End):
                return
            getattr(self, type(step).__name__.lower())(step)
        raise AssertionError("the night does not end")

    def _last(self, **change):
        *others, last = self.state.visits
        self.state = replace(self.state, visits=(*others, replace(last, **change)))

    def position(self, step):
        entry = self.plan.entry(step.field)
        assert self.now <= self.plan.last_begin(entry)
        assert entry.not_before is None or self.now >= entry.not_before
        fate = next(self.fates, VisitState.READY)
        state, short = (VisitState.READY, SHORT) if fate == SHORT else (fate, "")
        visit = Visited(step.field, step.repeat, step.dither, state, short=short)
        self.state = NightState((*self.state.visits, visit), parked=False)
        self.now += timedelta(seconds=80)

    def expose(self, step):
        visit, entry = self.state.underway, self.plan.entry(self.state.underway.field)
        if not visit.short:
            self.exposed.append((*visit.part, step.number))
        self.now += timedelta(seconds=entry.exposure_s)
        assert self.now <= min(self.plan.dawn, entry.not_after or self.plan.dawn)
        self._last(exposed=visit.exposed + 1, state=VisitState.EXPOSING)
        if next(self.fates, None) is VisitState.INTERRUPTED:
            self._last(state=VisitState.INTERRUPTED)

    def close(self, step):
        self._last(state=step.state)

    def wait(self, step):
        assert step.until > self.now
        self.now = step.until

    def park(self, step):
        assert not self.state.parked
        self.state = replace(self.state, parked=True)


fates = st.lists(
    st.sampled_from([VisitState.READY, VisitState.FAILED, VisitState.INTERRUPTED, SHORT]), max_size=20
)


@settings(max_examples=150)
@given(queues, fates)
def test_every_night_ends_parked_and_exposes_nothing_twice(plan, fates):
    night = Simulated(plan, fates)
    night.go()
    assert len(set(night.exposed)) == len(night.exposed)
    assert night.state.parked or not night.state.visits
    states = field_states(night.state, plan, night.now)
    for name in {visit.field for visit in night.state.visits if visit.short and visit.exposed}:
        mine = [v for v in night.state.visits if v.field == name and not v.short]
        enough = sum(v.exposed for v in mine) >= len(plan.entry(name).parts) * plan.entry(name).exposures
        assert states[name][0] is not VisitState.DONE or enough
    for name, repeat, dither, number in night.exposed:
        assert number <= plan.entry(name).exposures
        assert (repeat, dither) in plan.entry(name).parts


@settings(max_examples=60)
@given(queues)
def test_where_nothing_fails_and_nothing_is_bounded_all_is_exposed(plan):
    free = [e.model_copy(update={"not_before": None, "not_after": None}) for e in plan.fields]
    plan = plan.model_copy(update={"fields": tuple(free), "dawn": at(10**7)})
    night = Simulated(plan, [])
    night.go()
    assert len(night.exposed) == sum(len(e.parts) * e.exposures for e in plan.fields)
    states = field_states(night.state, plan, night.now)
    assert {state for state, _ in states.values()} == {VisitState.DONE}


@settings(max_examples=60)
@given(queues, fates)
def test_a_field_of_a_higher_priority_is_not_passed_over(plan, fates):
    night = Simulated(plan, fates)
    night.go()
    first = next((step for _, step in night.steps if isinstance(step, Position)), None)
    able = [e for e in plan.fields if (e.not_before or EVENING) <= EVENING <= plan.last_begin(e)]
    if able and night.steps[0][1] == first:
        assert plan.entry(first.field).priority == max(e.priority for e in able)


# the air


def test_altitudes_are_those_of_astropy():
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    place = EarthLocation(lon=-105.82 * u.deg, lat=32.78 * u.deg, height=0.0 * u.m)
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        for ra, dec, hours in ((10.0, 30.0, 3.0), (250.0, 60.0, 9.0), (130.0, -20.0, 12.0)):
            when = datetime(2024, 3, 1, 3, 0, tzinfo=UTC) + timedelta(hours=hours)
            frame = AltAz(obstime=Time(when.replace(tzinfo=None)), location=place)
            known = SkyCoord(ra, dec, unit="deg").transform_to(frame).alt.deg
            assert altitude_deg(ra, dec, -105.82, 32.78, when) == pytest.approx(known, abs=0.02)  # aberration


def test_airmass_overhead_is_one_and_there_is_none_below_the_horizon():
    ra = next(r for r in range(360) if altitude_deg(r, 32.78, -105.82, 32.78, EVENING) > 89.0)
    assert airmass(ra, 32.78, -105.82, 32.78, EVENING) == pytest.approx(1.0, abs=2e-4)
    assert airmass((ra + 180) % 360, -60.0, -105.82, 32.78, EVENING) == float("inf")


def test_a_field_waits_for_its_airmass():
    site = {"longitude_deg": -105.82, "latitude_deg": 32.78}
    rising = entry("a", ra_deg=100.0, dec_deg=20.0, airmass_max=1.5)
    plan = queue(rising, site=site, dawn=at(20 * 3600))
    now, waited = EVENING, 0
    while isinstance(step := next_step(NightState(), plan, now), Wait):
        now, waited = step.until, waited + 1
    assert step == Position("a", 0, 0)
    assert waited > 10
    assert plan.airmass_of(rising, now) <= 1.5 < plan.airmass_of(rising, now - timedelta(seconds=60))


# the file


GOOD = """
dawn = 2026-11-26T04:00:00Z
[[field]]
id = "a"
targets = "a.csv"
"""


def written(folder, text):
    (folder / "a.csv").write_text("target_id,x_mm,y_mm\n1,0,0\n")
    (folder / "q.toml").write_text(text)
    return folder / "q.toml"


def test_paths_are_from_the_folder_of_the_queue(tmp_path):
    read = read_queue(written(tmp_path, GOOD))
    assert read.fields[0].targets == tmp_path / "a.csv"
    assert read.dawn == datetime(2026, 11, 26, 4, tzinfo=UTC)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('targets = "a.csv"', 'targets = "b.csv"'), "b.csv: no such file; field 'a' of the queue names it"),
        (("dawn = 2026-11-26T04:00:00Z", ""), "dawn: Field required"),
        (('id = "a"', 'id = "a"\ncolour = "red"'), "colour = 'red': Extra inputs"),
        (('id = "a"', 'id = "a"\nairmass_max = 2.0'), "airmass_max: needs ra_deg and dec_deg"),
        (
            ('id = "a"', 'id = "a"\nairmass_max = 2.0\nra_deg = 1\ndec_deg = 1'),
            r"needs a \[site\] with longitude_deg",
        ),
        (('id = "a"', 'id = "a"\ntargets="a.csv"\n[[field]]\nid = "a"'), "field id 'a': is there twice"),
        (("dawn", "begin = 2026-11-27T04:00:00Z\ndawn"), "begin: must be earlier than dawn"),
        (('id = "a"', 'id = "a"\nexposure_s = 0'), "exposure_s = 0: Input should be greater than 0"),
    ],
)
def test_what_is_wrong_with_a_queue_is_told_in_one_line(tmp_path, change, words):
    with pytest.raises(InputError, match=words) as told:
        read_queue(written(tmp_path, GOOD.replace(*change)))
    assert "\n" not in str(told.value)
