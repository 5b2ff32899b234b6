"""`fiberloom sky`, and lists on the sky in `assign` and `observe`: from RA and Dec to light in the fibre."""

import contextlib
import csv
import json
import sqlite3

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.instruments import load_instrument
from fiberloom.sky import SkyTargets
from fiberloom.sky.sky_field import SkyField

HEAD = "source_id,ra,dec,pmra,pmdec,ref_epoch,fibre,priority"
FIELDS = {
    "sdssv": ("213.7042", "53.08333", "20.0", "2024-04-26T06:00:00", 0.03, 7),
    "desi": ("150.0", "20.0", "0.0", "2025-03-20T06:30:00", 0.08, 13),
    "pfs": ("150.0", "2.0", "-90.0", "2025-03-20T09:30:00", 0.04, 13),
}
"""RA, Dec, position angle, time, radius of the targets in deg, positioners."""


@pytest.fixture
def night(tmp_path):
    """Writes a field and a list for an instrument."""

    def make(name, n=40):
        ra, dec, pa, time, radius, positioners = FIELDS[name]
        field = tmp_path / "field.toml"
        field.write_text(
            f"ra_deg = {ra}\ndec_deg = {dec}\nposition_angle_deg = {pa}\n"
            f'time = "{time}"\ntime_scale = "utc"\nexposure_s = 900\n'
        )
        rng = np.random.default_rng(1)
        turn, off = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.random(n))
        x = float(ra) + off * np.cos(turn) / np.cos(np.radians(float(dec)))
        y = float(dec) + off * np.sin(turn)
        rows = [f"{k + 1},{x[k]:.9f},{y[k]:.9f},{10 * k},-20,2016,,{k % 3}" for k in range(n)]
        stars = tmp_path / "stars.csv"
        stars.write_text("\n".join([HEAD, *rows]) + "\n")
        return stars, field, positioners

    return make


OFF_MM = np.array([0.05, -0.02])


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def test_places_of_a_confsummary_are_its_own(fl, tmp_path, shared_sdssv):
    out = tmp_path / "places.csv"
    code, said, _ = fl("sky", "place", shared_sdssv / "confSummary-test.par.gz", "--out", out, "--json")
    assert code == 0
    assert json.loads(said)["places"] == 490
    rows = rows_of(out)
    assert list(rows[0]) == ["target_id", "positioner_id", "fibre", "x_mm", "y_mm"]
    assert rows[0]["positioner_id"] == "3"
    assert float(rows[0]["x_mm"]) == pytest.approx(-5.231433771462416, abs=1e-6)
    assert float(rows[0]["y_mm"]) == pytest.approx(-16.52309413812584, abs=1e-6)
    assert all(len(row["x_mm"].split(".")[1]) == 9 for row in rows)


def test_a_target_for_any_fibre_has_a_row_for_each(fl, night, tmp_path):
    stars, field, _ = night("sdssv")
    out = tmp_path / "places.csv"
    assert fl("sky", "place", stars, "--field", field, "--out", out)[0] == 0
    rows = rows_of(out)
    assert [row["fibre"] for row in rows[:4]] == ["BOSS", "APOGEE"] * 2
    assert len(rows) == 80
    assert rows[0]["positioner_id"] == ""
    assert rows[0]["x_mm"] != rows[1]["x_mm"]


def test_a_guide_star_has_one_place_at_the_guide_wavelength(fl, night, tmp_path):
    stars, field, _ = night("sdssv")
    with stars.open("a") as file:
        file.write("g,213.9,53.2,,,,guide,\n")
    out = tmp_path / "places.csv"
    assert fl("sky", "place", stars, "--field", field, "--out", out)[0] == 0
    (mine,) = (row for row in rows_of(out) if row["target_id"] == "g")
    assert mine["fibre"] == "guide"
    chain = SkyField.read(field).chain(load_instrument("sdssv"))
    place_mm = chain.place(SkyTargets.at(213.9, 53.2), "metrology").xy_mm[0]
    assert [float(mine["x_mm"]), float(mine["y_mm"])] == pytest.approx(place_mm, abs=1e-8)


def test_places_lead_back_to_the_sky(fl, night, tmp_path):
    stars, field, _ = night("sdssv")
    places, back = tmp_path / "places.csv", tmp_path / "back.csv"
    assert fl("sky", "place", stars, "--field", field, "--out", places)[0] == 0
    assert fl("sky", "where", places, "--field", field, "--out", back)[0] == 0
    found = {row["target_id"]: row for row in rows_of(back)}
    for k, row in enumerate(rows_of(stars)):
        # the star has moved since 2016
        moved = 8.3169 * np.array([10.0 * k, -20.0]) / 3.6e6
        there = found[row["source_id"]]
        east = (float(there["ra_deg"]) - float(row["ra"])) * np.cos(np.radians(float(row["dec"])))
        assert [east, float(there["dec_deg"]) - float(row["dec"])] == pytest.approx(moved, abs=3e-7)


def test_where_needs_to_know_the_fibre(fl, night, tmp_path):
    _, field, _ = night("sdssv")
    (tmp_path / "p.csv").write_text("x_mm,y_mm\n1,2\n")
    code, _, said = fl("sky", "where", tmp_path / "p.csv", "--field", field)
    assert code == 2
    assert "line 2: fibre is not given; --fibre: one of BOSS, APOGEE" in said
    out = tmp_path / "d.csv"
    assert fl("sky", "where", tmp_path / "p.csv", "--field", field, "--fibre", "BOSS", "--out", out)[0] == 0
    (tmp_path / "p.csv").write_text("x_mm,y_mm,fibre\n1e5,2,BOSS\n")
    assert "outside of the image" in fl("sky", "where", tmp_path / "p.csv", "--field", field)[2]


def test_drift_tells_what_guiding_leaves_and_how_long_an_exposure_may_be(fl, night, tmp_path):
    stars, field, _ = night("sdssv")
    code, said, _ = fl("sky", "drift", "--field", field, "--json")
    rows = json.loads(said)
    assert code == 0
    assert [(row["fibre"], row["exposure_min"]) for row in rows[:3]] == [
        ("BOSS", 15),
        ("BOSS", 30),
        ("BOSS", 60),
    ]
    assert all(row["largest_guided_um"] < row["largest_um"] for row in rows)
    assert rows[0]["largest_um"] < rows[1]["largest_um"] < rows[2]["largest_um"]
    assert rows[0]["longest_min"] > 15
    out = tmp_path / "drift.csv"
    assert fl("sky", "drift", stars, "--field", field, "--out", out)[0] == 0
    assert len(rows_of(out)) == 80
    assert "goes with a list" in fl("sky", "drift", "--field", field, "--out", out)[2]


def test_no_field(fl, night):
    stars, _, _ = night("sdssv")
    code, _, said = fl("sky", "place", stars)
    assert code == 2
    assert "--field: name the TOML file of the field" in said
    assert "has RA and Dec; give the field with --field" in fl("assign", stars, "--positioners", 7)[2]


def test_assignment_asks_for_the_place_of_the_fibre_it_gives(fl, night, tmp_path):
    """Each goal puts the fibre that it names on the place of that fibre."""
    stars, field, _ = night("sdssv")
    goal, places = tmp_path / "goal.csv", tmp_path / "places.csv"
    assert fl("assign", stars, "--field", field, "--positioners", 7, "--out", goal)[0] == 0
    assert fl("sky", "place", stars, "--field", field, "--out", places)[0] == 0
    from fiberloom.instruments import generate

    plane = generate(load_instrument("sdssv"), 0, n_positioners=7)
    wanted = {
        (row["target_id"], row["fibre"]): (float(row["x_mm"]), float(row["y_mm"])) for row in rows_of(places)
    }
    used = set()
    for k, row in enumerate(rows_of(goal)):
        if row["target_id"]:
            angles = np.full((2, 7), [[float(row["alpha_deg"])], [float(row["beta_deg"])]])
            there = plane.forward(*angles, row["fibre"])[k]
            assert there == pytest.approx(wanted[row["target_id"], row["fibre"]], abs=1e-5)
            used.add(row["fibre"])
    assert len(used) == 2


@pytest.mark.parametrize("name", list(FIELDS))
def test_stars_are_observed_on_the_twin(fl, night, tmp_path, name):
    """Where the fibres truly are, by the optics back to the sky, are the stars."""
    stars, field, positioners = night(name)
    out = tmp_path / "out"
    words = ["--field", field, "--instrument", name, "--positioners", positioners, "--camera", "noise"]
    code, said, _ = fl("observe", stars, *words, "--out", out, "--require", "0", "--json")
    assert code == 0
    summary = json.loads(said)
    assert summary["sky"]["exposure_s"] == 900.0
    assert summary["sky"]["reposition_every_s"] > 0.0
    model = load_instrument(name)
    chain = SkyField.read(field).chain(model)
    table = Table.read(out / "fibres.ecsv", format="ascii.ecsv")
    done = table[(table["move"] == table["move"].max()) & np.isfinite(table["x_target_mm"])]
    catalogue = {row["source_id"]: row for row in rows_of(stars)}
    off_um = []
    for row in done.filled(""):
        star = catalogue[str(row["target_id"])]
        radec = chain.sky([[row["x_true_mm"], row["y_true_mm"]]], chain.wavelength_of(row["fibre"]))[0]
        years = chain.pointing.time.julian_year - 2016.0
        dec = float(star["dec"]) + years * float(star["pmdec"]) / 3.6e6
        east = (radec[0] - float(star["ra"])) * np.cos(np.radians(dec)) - years * float(star["pmra"]) / 3.6e6
        arcsec = 3600.0 * np.hypot(east, radec[1] - dec)
        off_um.append((arcsec, row["true_error_um"]))
    arcsec, error_um = np.transpose(off_um)
    assert len(off_um) >= 4
    # um per arcsec of the three telescopes: 61, 67.5 and 90
    scale = {"sdssv": 61.0, "desi": 67.5, "pfs": 89.0}[name]
    assert arcsec * scale == pytest.approx(error_um, rel=0.05, abs=0.1)
    assert np.median(error_um) < 5.0
    assert (out / "fibermap.fits").exists()
    assert (out / "confSummaryF.par").exists() == (name == "sdssv")


def test_fibres_follow_their_targets_through_a_series(fl, night, tmp_path):
    """At airmass 1.3 and rising: without moves they lose them, with moves they do not."""
    stars, field, _ = night("sdssv")
    field.write_text(field.read_text().replace("06:00:00", "09:15:00").replace("= 900", "= 1200"))
    words = ["--field", field, "--positioners", 7, "--camera", "noise", "--out", tmp_path / "out"]
    code, said, _ = fl("observe", stars, *words, "--exposures", 4, "--json")
    summary = json.loads(said)
    assert code == 0
    labels = [move["label"] for move in summary["moves"]]
    assert [label for label in labels if "re-position" in label] == [
        "re-position 1",
        "re-position 2",
        "re-position 3",
    ]
    series = summary["series"]
    assert [one["begin_s"] for one in series] == [0.0, 1200.0, 2400.0, 3600.0]
    assert series[0]["worst_um"] == series[0]["worst_unless_moved_um"]
    assert all(one["worst_um"] < summary["requirement_um"] for one in series)
    # near the centre of the field little is lost; what drift there is adds up unless they follow
    stayed = [one["drift_unless_moved_um"] for one in series]
    assert stayed == sorted(stayed)
    assert stayed[-1] > 2.0 * series[-1]["drift_um"]
    # errors of each move are of where its targets were then
    table = Table.read(tmp_path / "out" / "fibres.ecsv", format="ascii.ecsv")
    moves = [table[table["move"] == move["move"]] for move in summary["moves"]]
    first, last = moves[0], moves[-1]
    assert np.nanmax(np.abs(first["x_target_mm"] - last["x_target_mm"])) > 1e-4
    apart_um = 1e3 * np.hypot(
        last["x_true_mm"] - last["x_target_mm"], last["y_true_mm"] - last["y_target_mm"]
    )
    assert np.asarray(apart_um) == pytest.approx(np.asarray(last["true_error_um"]), abs=1e-6, nan_ok=True)


def test_a_run_on_the_sky_is_shown_again(fl, night, tmp_path):
    """Also where each fibre looked, as it was written by the run itself."""
    stars, field, _ = night("sdssv")
    words = ["--field", field, "--positioners", 7, "--camera", "noise", "--out", tmp_path / "out"]
    assert fl("observe", stars, *words, "--exposures", 2)[0] == 0
    names = ("summary.json", "fibres.ecsv", "fibermap.fits", "confSummaryF.par")
    kept = {name: (tmp_path / "out" / name).read_bytes() for name in names}
    code, said, _ = fl("show", 1, tmp_path / "out", "--out", tmp_path / "again")
    assert code == 0
    for name, content in kept.items():
        assert (tmp_path / "again" / name).read_bytes() == content
    table = Table.read(tmp_path / "out" / "fibermap.fits")
    when, n = table.meta["MIDUTC"], len(table)
    assert f"RA and Dec under {n} fibres, ICRS at {when} UTC: fibermap.fits and confSummaryF.par" in said
    (tmp_path / "again" / "fibermap.fits").unlink()
    _without_directions(tmp_path / "out" / "store.sqlite")
    code, said, _ = fl("show", 1, tmp_path / "out", "--out", tmp_path / "again")
    assert code == 0
    assert "not made: fibermap.fits (the run did not come to its end, or is of a version" in said
    assert not (tmp_path / "again" / "fibermap.fits").exists()


def _without_directions(store):
    """As a version before kept it."""
    with contextlib.closing(sqlite3.connect(store)) as connection:
        assert connection.execute("DELETE FROM parts WHERE name = 'fibermap'").rowcount == 1
        connection.commit()


def test_a_series_needs_the_sky(fl, night, tmp_path):
    (tmp_path / "flat.csv").write_text("target_id,x_mm,y_mm\na,1,12\n")
    words = [tmp_path / "flat.csv", "--positioners", 7, "--camera", "noise", "--out", tmp_path / "out"]
    code, _, said = fl("observe", *words, "--exposures", 2)
    assert code == 2
    assert "a series of exposures: needs a list with ra and dec, and a field with exposure_s above 0" in said


@pytest.mark.parametrize("name", ["sdssv", "desi", "pfs"])
def test_guide_stars_tell_where_the_telescope_points(fl, night, tmp_path, name):
    """A field that is off, turned and larger than assumed: the next field file has its stars."""
    stars, path, _ = night(name, 60)
    field, model = SkyField.read(path), load_instrument(name)
    scale = field.chain(model).view.scale
    keys = {"position_angle_deg": field.position_angle_deg + 0.02, "scale": scale * (1 - 2e-4)}
    true = field.model_copy(update=keys)
    from fiberloom.targets.read import read_sky

    found, _ = read_sky(stars)
    seen_mm = true.chain(model).place(found.targets, "metrology").xy_mm + OFF_MM
    lines = stars.read_text().splitlines()
    rows = [f"{line},{x:.9f},{y:.9f}" for line, (x, y) in zip(lines[1:], seen_mm, strict=True)]
    stars.write_text("\n".join([lines[0] + ",x_mm,y_mm", *rows]) + "\n")
    after = tmp_path / "next.toml"
    code, said, _ = fl("sky", "guide", stars, "--field", path, "--instrument", name, "--out", after, "--json")
    assert code == 0
    told = json.loads(said)
    assert told["rotation_arcsec"] == pytest.approx(72.0, abs=0.5)
    assert told["scale_ppm"] == pytest.approx(200.0, abs=2.0)
    # the turn is about the axis of the rotator: on PFS it is not at the origin
    assert [told["offset_x_um"], told["offset_y_um"]] == pytest.approx([50.0, -20.0], abs=0.5)
    arcsec = np.hypot(told["points_off_ra_arcsec"], told["points_off_dec_arcsec"])
    assert arcsec == pytest.approx(53.85 / {"sdssv": 61.0, "desi": 67.5, "pfs": 89.0}[name], rel=0.02)
    again = SkyField.read(after).chain(model).place(found.targets, "metrology").xy_mm
    assert 1e3 * np.abs(again + OFF_MM - seen_mm).max() < 0.3


def test_a_field_file_is_written_as_it_is_read(tmp_path):
    text = (
        'ra_deg = 1.5\ndec_deg = -2.0\ntime = "2024-04-26T06:00:00"\ntime_scale = "tai"\n'
        "polar_motion = true\n"
        "[site]\nlongitude_deg = 10.0\nlatitude_deg = 20.0\nheight_m = 30.0\n"
        "[weather]\npressure_hPa = 700.0\ntemperature_C = 1.0\nhumidity = 0.1\n"
    )
    (tmp_path / "a.toml").write_text(text)
    field = SkyField.read(tmp_path / "a.toml")
    field.write(tmp_path / "b.toml")
    assert SkyField.read(tmp_path / "b.toml") == field


# what pipelines downstream get


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """An observation of stars, its folder."""
    import fiberloom as fl
    from fiberloom.instruments import generate
    from fiberloom.operation.results.fibermap import write_fibermap
    from fiberloom.targets import read_targets

    folder = tmp_path_factory.mktemp("exported")
    ra, dec, pa, time, _, _ = FIELDS["sdssv"]
    (folder / "field.toml").write_text(
        f'ra_deg = {ra}\ndec_deg = {dec}\nposition_angle_deg = {pa}\ntime = "{time}"\ntime_scale = "utc"\n'
    )
    rng = np.random.default_rng(5)
    x, y = 213.7042 + rng.uniform(-0.05, 0.05, 30), 53.08333 + rng.uniform(-0.03, 0.03, 30)
    rows = [f"{900 + k},{x[k]:.9f},{y[k]:.9f},{10 * k},-20,2016,,1" for k in range(30)]
    (folder / "stars.csv").write_text("\n".join([HEAD, *rows]) + "\n")
    plane = generate(load_instrument("sdssv"), 0, n_positioners=7)
    field = fl.Field.twin(plane, seed=0, camera="noise")
    seen = field.run.observe(read_targets(folder / "stars.csv", folder / "field.toml"), out=folder / "out")
    assert write_fibermap(seen, folder) == ["fibermap.fits", "confSummaryF.par"]
    return folder, seen


def test_a_fibre_map_says_where_each_fibre_looks(exported):
    folder, seen = exported
    table = Table.read(folder / "fibermap.fits")
    plane, move = seen.plane, seen.final
    assert len(table) == sum(int(plane.carries(f).sum()) for f in ("BOSS", "APOGEE"))
    names = table["TARGET_ID"].filled("")
    taken = table[names != ""]
    assert len(taken) == seen.assignment.n_assigned
    # on target: RA and Dec of fibre and star, by 61 um an arcsec
    apart_um = 61.0 * np.hypot(taken["OFFSET_RA"], taken["OFFSET_DEC"])
    assert np.asarray(apart_um) == pytest.approx(np.asarray(taken["ERROR_UM"]), rel=0.05, abs=0.02)
    assert (taken["ERROR_UM"] < 6.0).all()
    # every fibre, with and without a target, is where the twin has it
    truth = {}
    for k, number in enumerate(plane.positioner_id):
        if seen.assignment.target[k] >= 0:
            truth[int(number), str(seen.assignment.fibre[k])] = move.true_mm[k]
    for row in taken:
        there = truth[int(row["POSITIONER_ID"]), str(row["FIBRE"])]
        assert 1e3 * np.hypot(row["X_MM"] - there[0], row["Y_MM"] - there[1]) < 5.0
    free = table[names == ""]
    assert np.isfinite(free["FIBRE_RA"]).all()
    assert (free["STATUS"] & 1).all()
    assert not (taken["STATUS"] & 1).any()
    assert table.meta["SITE"] == "apo"


def test_two_fibres_of_one_arm_are_0_75_mm_apart(exported):
    folder, seen = exported
    table = Table.read(folder / "fibermap.fits")
    pairs = 0
    for number in seen.plane.positioner_id:
        mine = table[table["POSITIONER_ID"] == number]
        if len(mine) == 2:
            apart_mm = np.hypot(*np.diff([mine["X_MM"], mine["Y_MM"]], axis=1))[0]
            assert apart_mm == pytest.approx(0.752, abs=0.08)
            pairs += 1
    assert pairs


def test_a_confsummary_of_ours_is_read_as_one_of_theirs(exported, fl, tmp_path):
    """Its sky columns lead to the places that the fibres were put on."""
    folder, seen = exported
    out = tmp_path / "places.csv"
    code, said, _ = fl("sky", "place", folder / "confSummaryF.par", "--out", out, "--json")
    assert code == 0, said
    found = {int(row["positioner_id"]): row for row in rows_of(out)}
    good = seen.on_target(seen.final)
    assert len(found) == int(good.sum())
    for k in np.flatnonzero(good):
        row, there = found[int(seen.plane.positioner_id[k])], seen.target_mm()[k]
        assert row["fibre"] == seen.assignment.fibre[k]
        # the TAI of the file in one number is good to 40 us
        assert [float(row["x_mm"]), float(row["y_mm"])] == pytest.approx(there, abs=1e-6)


@pytest.mark.parametrize("name", ["sdssv", "desi", "pfs"])
def test_a_telescope_that_points_too_far_east_and_south_is_told_so(fl, night, tmp_path, name):
    stars, path, _ = night(name, 60)
    field, model = SkyField.read(path), load_instrument(name)
    east_deg, south_deg = 1.0 / 3600.0 / np.cos(np.radians(field.dec_deg)), -2.0 / 3600.0
    true = field.model_copy(update={"ra_deg": field.ra_deg + east_deg, "dec_deg": field.dec_deg + south_deg})
    from fiberloom.targets.read import read_sky

    found, _ = read_sky(stars)
    seen_mm = true.chain(model).place(found.targets, "metrology").xy_mm
    lines = stars.read_text().splitlines()
    rows = [f"{line},{x:.9f},{y:.9f}" for line, (x, y) in zip(lines[1:], seen_mm, strict=True)]
    stars.write_text("\n".join([lines[0] + ",x_mm,y_mm", *rows]) + "\n")
    code, said, _ = fl("sky", "guide", stars, "--field", path, "--instrument", name, "--json")
    told = json.loads(said)
    assert code == 0
    assert [told["points_off_ra_arcsec"], told["points_off_dec_arcsec"]] == pytest.approx(
        [1.0, -2.0], abs=0.01
    )


def test_guide_stars_with_errors_say_how_well_a_place_at_the_edge_is_known(fl, night, tmp_path):
    """sigma sqrt((1 + r^2 / g^2) / N) for stars of 6 um all over a disc, whose rms radius is g."""
    stars, path, _ = night("sdssv", 200)
    from fiberloom.targets.read import read_sky

    found, _ = read_sky(stars)
    chain = SkyField.read(path).chain(load_instrument("sdssv"))
    place_mm = chain.place(found.targets, "metrology").xy_mm
    seen_mm = place_mm + 6e-3 * np.random.default_rng(0).standard_normal(place_mm.shape)
    lines = stars.read_text().splitlines()
    rows = [f"{line},{x:.9f},{y:.9f}" for line, (x, y) in zip(lines[1:], seen_mm, strict=True)]
    stars.write_text("\n".join([lines[0] + ",x_mm,y_mm", *rows]) + "\n")
    told = json.loads(fl("sky", "guide", stars, "--field", path, "--json")[1])
    spread_mm = np.sqrt(((place_mm - place_mm.mean(axis=0)) ** 2).sum(axis=1).mean())
    expected_um = 6.0 * np.sqrt((1.0 + (333.2 / spread_mm) ** 2) / 200)
    # 200 stars tell their scatter to 4 %
    assert told["star_sigma_um"] == pytest.approx(6.0, rel=0.12)
    assert told["error_at_edge_um"] == pytest.approx(expected_um, rel=0.12)
    assert abs(told["scale_ppm"]) < 4 * told["scale_error_ppm"]
