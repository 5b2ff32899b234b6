"""Guide stars in an observation: what they tell moves the goals, and is taken off where fibres look."""

import asyncio
import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.assignment import assign
from fiberloom.connect import open_hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.move import Goals
from fiberloom.operation.series.guided import FARTHEST_MM, IMAGES, Guiding
from fiberloom.operation.series.reach import to_the_end
from fiberloom.operation.series.steps import followed
from fiberloom.operation.stopping import StopRule
from fiberloom.sky.guiding import FieldOffset
from fiberloom.sky.pointed import offset_report, plate_um_arcsec
from fiberloom.targets import read_targets
from fiberloom.twin.errors.pointing import PointingSizes
from fiberloom.twin.sky.guider import TwinGuider

FIELD = """ra_deg = 166.79
dec_deg = 0.0
position_angle_deg = 30.0
time = "2024-04-26T06:00:00"
time_scale = "utc"
exposure_s = 300.0
"""
HEAD = "source_id,ra,dec,fibre\n"


def guides(n, radius_deg=1.3):
    around = 2.0 * np.pi * np.arange(n) / n
    return [
        f"g{k},{166.79 + radius_deg * np.cos(a):.9f},{radius_deg * np.sin(a):.9f},guide"
        for k, a in enumerate(around)
    ]


def listed(folder, n_guides=10, more=()):
    rng = np.random.default_rng(2)
    rows = [f"{k},{166.79 + rng.uniform(-0.1, 0.1):.9f},{rng.uniform(-0.1, 0.1):.9f}," for k in range(60)]
    (folder / "stars.csv").write_text(HEAD + "\n".join([*rows, *guides(n_guides), *more]) + "\n")
    (folder / "field.toml").write_text(FIELD)
    return folder / "stars.csv", folder / "field.toml"


class Seen:
    """A guider that sees stars where it is told, to 1 um."""

    def __init__(self, off, wild=(), dark=()):
        self.off, self.wild, self.dark = off, list(wild), list(dark)
        self.rng = np.random.default_rng(0)

    def stars(self, chain):
        return None

    def look(self, stars, chain):
        seen = self.off.applied(chain.place(stars).xy_mm) + 1e-3 * self.rng.standard_normal((len(stars), 2))
        seen[self.wild] += 0.3 * self.rng.uniform(0.5, 1.0, (len(self.wild), 2))
        seen[self.dark] = np.nan
        return seen

    def star_um(self, chain):
        return 1.0

    def truth(self, chain):
        return None


OFF = FieldOffset(np.array([0.06, -0.04]), 0.01, 1.0001)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    plane = FocalPlane.of("sdssv", seed=0, n=19)
    targets = read_targets(*listed(tmp_path_factory.mktemp("guided")))
    return plane, targets, assign(plane, targets)


def guiding(field, guider):
    plane, targets, assignment = field
    found = Guiding.of(guider, targets.on_sky, plane, assignment)
    assert found is not None
    return found


def test_goals_go_where_the_stars_are(field):
    plane, targets, assignment = field
    own = guiding(field, Seen(OFF))
    found = own.look(0)
    assert found.text.startswith("guiding, exposure 1: 10 of 10 stars seen; 10 used")
    goals = own.aimed(Goals.of(assignment), found)
    has = np.flatnonzero(assignment.target >= 0)
    assert len(has) > 10
    star_mm = OFF.applied(targets.on_sky.places_mm(assignment.target, assignment.fibre))
    # ten stars of 1 / sqrt(4 images) um: 0.2 um at the centre
    assert 1e3 * np.abs(goals.target_mm - star_mm)[has].max() < 1.0
    for k in has:
        at = plane.forward(*np.tile(goals.angles_deg[k], (plane.n, 1)).T, assignment.fibre[k])[k]
        assert at == pytest.approx(goals.target_mm[k], abs=1e-6)
    assert found.about()["chi2"] / found.about()["freedom"] < 3.0


def test_a_wild_star_is_left_out_and_one_that_is_not_there_is_named(field):
    found = guiding(field, Seen(OFF, wild=[3], dark=[7])).look(0)
    assert "9 of 10 stars seen (not seen: g7); 8 used (left out: g3)" in found.text
    assert found.text.endswith("applied")
    assert not found.why_not
    assert found.fit.offset_mm == pytest.approx([0.06, -0.04], abs=2e-3)


@pytest.mark.parametrize(
    ("guider", "told"),
    [
        (Seen(OFF, dark=range(9)), "1 guide stars; offset and rotation need 2"),
        (Seen(OFF, dark=range(10)), "0 guide stars; offset and rotation need 2"),
        (Seen(OFF, wild=range(0, 10, 2)), "guide stars do not agree"),
        (Seen(FieldOffset(np.array([0.0, 2 * FARTHEST_MM]), 0.0, 1.0)), "the telescope points off by 1.0 mm"),
    ],
)
def test_what_cannot_be_believed_is_not_applied(field, guider, told):
    own = guiding(field, guider)
    found = own.look(0)
    assert found.applied is None
    assert told in found.text
    assert "not applied" in found.text
    goals = own.aimed(Goals.of(field[2]), found)
    assert goals.target_mm is None
    assert (goals.angles_deg == field[2].goal_deg).all()


def test_without_stars_or_a_guider_there_is_no_guiding(field):
    plane, targets, assignment = field
    assert Guiding.of(None, targets.on_sky, plane, assignment) is None
    assert Guiding.of(Seen(OFF), None, plane, assignment) is None

    alone = replace(targets.on_sky, guides=None)
    assert Guiding.of(Seen(OFF), alone, plane, assignment) is None
    still, off = (TwinGuider(PointingSizes().times(factor), 0) for factor in (0.0, 1.0))
    assert Guiding.of(still, alone, plane, assignment) is None
    assert Guiding.of(off, alone, plane, assignment) is not None


def test_the_twin_s_stars_tell_how_far_it_is_off_within_their_errors(field):
    chain = field[1].on_sky.chain
    # (found - true) / error, of 40 telescopes with 24 stars each: normal numbers
    pulls = []
    for seed in range(40):
        guider = TwinGuider(PointingSizes(), seed)
        found = guiding(field, guider).look(0)
        true, sigma = guider.truth(chain), np.sqrt(np.diag(found.fit.covariance))
        off = [
            *(found.fit.offset_mm - true.offset_mm),
            np.radians(found.fit.rotation_deg - true.rotation_deg),
        ]
        pulls.append(np.array([*off, found.fit.scale - true.scale]) / sigma)
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    # 40 draws tell an rms to 11 %
    assert rms == pytest.approx(np.ones(4), abs=0.35)


def test_the_twin_s_telescope_is_off_by_what_is_told(field):
    chain = field[1].on_sky.chain
    told = [offset_report(chain, TwinGuider(PointingSizes(), seed).truth(chain)) for seed in range(150)]
    for key, size in (
        ("points_off_ra_arcsec", 1.0),
        ("points_off_dec_arcsec", 1.0),
        ("rotation_arcsec", 20.0),
        ("scale_ppm", 50.0),
    ):
        # 150 draws tell an rms to 6 %
        assert np.sqrt(np.mean([one[key] ** 2 for one in told])) == pytest.approx(size, rel=0.2)
    # of APO's optics at the centre
    assert plate_um_arcsec(chain) == pytest.approx(60.97, rel=0.002)
    guider = TwinGuider(PointingSizes(), 0)
    stars = guider.stars(chain)
    assert len(stars) == 24
    off_um = 1e3 * (guider.look(stars, chain) - guider.truth(chain).applied(chain.place(stars).xy_mm))
    # 48 numbers tell it to 10 %
    assert off_um.std() == pytest.approx(6.1, rel=0.35)
    assert IMAGES == 4


# end to end on the twin


@pytest.fixture(scope="module")
def observed(tmp_path_factory):
    """A telescope that points off, and guide stars of the list, of which one is out of the field."""
    import fiberloom as fl
    from fiberloom.operation.results.fibermap import write_fibermap

    folder = tmp_path_factory.mktemp("observed")
    stars, field = listed(folder, more=["far,169.5,0,guide"])
    plane = FocalPlane.of("sdssv", seed=0, n=7)
    twin = fl.Field(plane, open_hardware(plane, "twin:", "noise", seed=3, errors="pointing=2"), 3)
    seen = twin.run.observe(read_targets(stars, field), out=folder / "out")
    write_fibermap(seen, folder)
    return folder, seen


def test_the_blind_move_misses_the_stars_and_the_corrections_do_not(observed):
    _, seen = observed
    blind, last = seen.moves[0], seen.final
    true = seen.about["guiding"][0]["truth"]
    off_um = np.hypot(true["offset_x_um"], true["offset_y_um"])
    assert off_um > 60.0
    # what the gears do besides is 11 um
    assert np.nanmedian(seen.true_error_um(blind)) == pytest.approx(off_um, abs=25.0)
    assert np.nanmax(seen.true_error_um(last)[seen.counted(last)]) < seen.requirement_um
    told = seen.about["guiding"][0]
    assert told["applied"]
    assert told["not_seen"] == ["far"]
    sigma_um = told["offset_error_um"]
    assert told["offset_x_um"] == pytest.approx(true["offset_x_um"], abs=4 * sigma_um)
    assert told["offset_y_um"] == pytest.approx(true["offset_y_um"], abs=4 * sigma_um)
    assert seen.summary()["budget"]["guiding_um"] < 4.0


def test_the_fibre_map_has_the_stars_under_the_fibres(observed):
    """In mm they are beside the places of the chain by what the telescope is off; on the sky they are not."""
    folder, seen = observed
    table = Table.read(folder / "fibermap.fits")
    taken = table[table["TARGET_ID"].filled("") != ""]
    t = seen.targets.on_sky.targets
    catalogue = dict(zip(t.target_id.tolist(), np.column_stack([t.ra_deg, t.dec_deg]), strict=True))
    off_um = []
    for row in taken:
        ra, dec = catalogue[str(row["TARGET_ID"])]
        east = (row["FIBRE_RA"] - ra) * np.cos(np.radians(dec))
        off_um.append(61.0 * 3600.0 * np.hypot(east, row["FIBRE_DEC"] - dec))
    assert len(off_um) >= 5
    # as measured: error of the fibre, and of nothing else
    assert np.asarray(taken["ERROR_UM"]) == pytest.approx(off_um, rel=0.05, abs=0.05)
    first_mm = seen.targets.on_sky.places_mm(seen.assignment.target, seen.assignment.fibre)
    shift_um = 1e3 * np.hypot(*(seen.target_mm(seen.final) - first_mm).T)
    assert np.nanmin(shift_um) > 50.0
    assert table.meta["GUIDEX"] == pytest.approx(1e-3 * seen.about["guiding"][0]["offset_x_um"])


def test_it_is_shown_again_from_the_store(observed, fl, tmp_path):
    folder, seen = observed
    from fiberloom.operation.past.rebuild import info_of_run, observation_of
    from fiberloom.store import Store

    with Store.read(folder / "out" / "store.sqlite") as store:
        again, _ = observation_of(store, info_of_run(store, 1))
    assert again.summary() == json.loads(json.dumps(seen.summary()))
    assert again.final.pointed.offset_mm == pytest.approx(seen.final.pointed.offset_mm, abs=0.0)
    code, said, _ = fl("show", 1, folder / "out", "--out", tmp_path / "again")
    assert code == 0
    assert "guiding, exposure 1: 10 of 11 stars seen (not seen: far)" in said
    assert "in truth " in said


def test_without_a_correction_nothing_is_applied(fl, tmp_path):
    stars, field = listed(tmp_path, 4)
    words = ["--field", field, "--positioners", 7, "--camera", "noise", "--out", tmp_path / "out"]
    code, said, _ = fl("observe", stars, *words, "--moves", 1, "--require", 0, "--json")
    assert code == 0
    told = json.loads(said)["guiding"]
    assert told[0]["why_not"] == "no correction is to be made"
    assert not told[0]["applied"]
    # a telescope that points as it should
    assert told[0]["truth"]["offset_x_um"] == 0.0
    assert abs(told[0]["offset_x_um"]) < 5 * told[0]["offset_error_um"]


def test_goals_that_have_moved_get_a_correction_however_good_the_blind_move_was():
    loop = Loop.__new__(Loop)
    loop.settings = LoopSettings(stop=StopRule("percentile", 90.0, 5.0))
    made = []

    async def correct(_, label):
        made.append(label)

    loop.correct, loop._open_um = correct, lambda: np.zeros(0)
    loop._note_arrived = lambda last=False: None
    assert loop.settings.stop.satisfied(np.zeros(0))
    asyncio.run(loop._corrected(None, 3, moved=True))
    assert made == ["correction 1"]
    asyncio.run(loop._corrected(None, 3, moved=False))
    assert made == ["correction 1"]


def test_an_observatory_gives_its_own_guider():
    """To an array outside of this process; the array itself stays as it was."""
    plane = FocalPlane.of("sdssv", seed=0, n=7)
    for bus in ("cannet://127.0.0.1", "fpga://127.0.0.1"):
        array = open_hardware(plane, bus, Camera())
        mine = Seen(OFF)
        assert array.guided_by(mine).guider is mine
        assert array.guider is None
        assert array.guided_by(mine).named() == array.named()


class Camera:
    """Sees nothing."""

    def measure(self, expected_mm):
        raise NotImplementedError


def test_a_target_that_goes_out_of_reach_is_followed_to_the_end_of_the_arms(field):
    plane, _, assignment = field

    row = int(np.flatnonzero(assignment.target >= 0)[0])
    fibre = str(assignment.fibre[row])

    def at(angles_deg):
        return plane.forward(*np.tile(angles_deg, (plane.n, 1)).T, fibre)[row]

    here_mm = at(assignment.goal_deg[row])
    out = here_mm - plane.centres_mm[row]
    shift_mm = np.zeros((plane.n, 2))
    shift_mm[row] = 30.0 * out / np.hypot(*out)
    found = to_the_end(plane, assignment, shift_mm, followed(plane, assignment, shift_mm))
    there_mm = at(found.angles_deg[row])
    assert there_mm + found.short_mm[row] == pytest.approx(here_mm + shift_mm[row], abs=1e-9)
    # stretched, on the line to the target
    reach_mm = plane.l_alpha_mm[row] + np.hypot(*plane.points[fibre][row])
    assert np.hypot(*(there_mm - plane.centres_mm[row])) == pytest.approx(reach_mm, abs=1e-4)
    others = np.arange(plane.n) != row
    assert (found.short_mm[others] == 0.0).all()
    assert found.angles_deg[others] == pytest.approx(assignment.goal_deg[others], abs=1e-9)


def test_the_loop_does_not_wait_for_what_is_out_of_reach():
    loop = Loop.__new__(Loop)
    plane = FocalPlane.of("sdssv", seed=0, n=7)
    loop.plane, short_mm = plane, np.zeros((7, 2))
    loop.goals = Goals.without_targets(plane, plane.park_deg)
    assert not loop._out_of_reach.any()
    short_mm[3] = [0.05, 0.0]
    loop.goals = replace(loop.goals, short_mm=short_mm)
    assert np.flatnonzero(loop._out_of_reach).tolist() == [3]


def test_a_fibre_at_the_end_of_its_arms_is_said_to_be_off_its_star(tmp_path):
    """By the image, in the fibre map and by name: not as if its target were where it can go."""
    import fiberloom as fl
    from fiberloom.health.status import FibreStatus
    from fiberloom.operation.results.fibermap import fibermap

    seed, plane = 3, FocalPlane.of("sdssv", seed=0, n=7)
    stars, field_file = listed(tmp_path, 8)
    chain = read_targets(stars, field_file).on_sky.chain
    off_mm = TwinGuider(PointingSizes().times(2.0), seed).truth(chain).offset_mm
    reach_mm = plane.l_alpha_mm[0] + np.hypot(*plane.points["BOSS"][0])
    end_mm = plane.centres_mm[0] + (reach_mm - 0.03) * off_mm / np.hypot(*off_mm)
    ra, dec = chain.sky(end_mm, chain.wavelength_of("BOSS"))[0]
    number = int(plane.positioner_id[0])
    rows = [f"end,{ra:.9f},{dec:.9f},BOSS,{number}", *(f"{row}," for row in guides(8))]
    stars.write_text("source_id,ra,dec,fibre,positioner_id\n" + "\n".join(rows) + "\n")
    twin = fl.Field(plane, open_hardware(plane, "twin:", "noise", seed=seed, errors="pointing=2"), seed)
    seen = twin.run.observe(read_targets(stars, field_file), out=tmp_path / "out")
    assert seen.about["guiding"][0]["out_of_reach"] == [number]
    last, short_um = seen.final, 1e3 * np.hypot(*seen.final.short_mm[0])
    assert short_um > 30.0
    assert last.measured_error_um[0] == pytest.approx(short_um, abs=5.0)
    assert seen.true_error_um(last)[0] == pytest.approx(short_um, abs=5.0)
    assert last.status[0] is FibreStatus.OFF_TARGET
    table = fibermap(seen)
    (mine,) = table[table["TARGET_ID"] == "end"]
    assert [mine["X_MM"], mine["Y_MM"]] == pytest.approx(last.true_mm[0], abs=5e-3)
