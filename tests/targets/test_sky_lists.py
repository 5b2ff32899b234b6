"""Lists on the sky: columns by many names, what is missing, what is refused, and the field file."""

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.sky.sky_field import SkyField
from fiberloom.targets import read_targets
from fiberloom.targets.read import read_sky

FIELD = """
ra_deg = 213.7042
dec_deg = 53.08333
time = "2024-04-26T06:00:00"
time_scale = "utc"
exposure_s = 900.0
"""
LIST = """target_id,ra,dec,pmra,pmdec,parallax,epoch,fibre,priority
a,213.70,53.08,10,-1200,5,2016,BOSS,2
b,213.72,53.09,,,,,,1
"""


@pytest.fixture
def field(tmp_path):
    (tmp_path / "field.toml").write_text(FIELD)
    return tmp_path / "field.toml"


def write(path, text):
    path.write_text(text)
    return path


def test_a_list_in_csv_ecsv_and_fits_is_one_list(tmp_path, field):
    csv = read_targets(write(tmp_path / "a.csv", LIST), field)
    table = Table.read(tmp_path / "a.csv", format="ascii.csv")
    table["fibre"] = ["BOSS", ""]
    for kind in ("ecsv", "fits"):
        table.write(tmp_path / f"a.{kind}")
        other = read_targets(tmp_path / f"a.{kind}", field)
        assert other.xy_mm == pytest.approx(csv.xy_mm, abs=1e-9)
        assert (other.target_id == csv.target_id).all()
        assert other.priority.tolist() == [2.0, 1.0]


def test_names_of_gaia_and_of_sdss(tmp_path, field):
    ours = read_targets(write(tmp_path / "a.csv", LIST), field)
    for names in (
        "source_id,ra,dec,pmra,pmdec,parallax,ref_epoch,fibre,priority",
        "CATALOGID,RACAT,DECCAT,PMRA,PMDEC,PARALLAX,COORD_EPOCH,FIBERTYPE,PRIORITY",
    ):
        text = names + LIST[LIST.index("\n") :]
        theirs = read_targets(write(tmp_path / "b.csv", text), field)
        assert theirs.xy_mm == pytest.approx(ours.xy_mm, abs=1e-12)
        assert theirs.fibre.tolist() == ["BOSS", ""]


def test_each_fibre_has_a_place_of_its_own(tmp_path, field):
    targets = read_targets(write(tmp_path / "a.csv", LIST), field)
    boss, apogee = targets.place_mm("BOSS"), targets.place_mm("APOGEE")
    assert (1e3 * np.hypot(*(boss - apogee).T) > 5.0).all()
    assert targets.xy_mm == pytest.approx(boss)  # asked for, and the first fibre of who asks for none
    settled = targets.settled(np.array([-1, 1]), np.array(["", "APOGEE"]))
    assert settled.xy_mm[1] == pytest.approx(apogee[1])
    assert settled.xy_mm[0] == pytest.approx(boss[0])
    moved = targets.moved(np.array([1.0, -2.0]))
    assert moved.place_mm("APOGEE") == pytest.approx(apogee + np.array([1.0, -2.0]))
    assert targets.select(np.array([1])).place_mm("APOGEE") == pytest.approx(apogee[1:])


def test_minus_999_is_missing_and_minus_1200_is_not(tmp_path, field):
    """A fast star keeps its motion; -999, NaN and nothing are none."""
    fast = read_targets(write(tmp_path / "a.csv", LIST), field).xy_mm[0]
    still = read_targets(write(tmp_path / "b.csv", LIST.replace("-1200", "-999")), field).xy_mm[0]
    # 8.3 years of 1.2 arcsec, 61 um/arcsec
    assert 1e3 * np.hypot(*(fast - still)) == pytest.approx(8.32 * 1.2 * 61.0, rel=0.02)
    for missing in ("-999.0", "nan", ""):
        same = read_targets(write(tmp_path / "b.csv", LIST.replace("-1200", missing)), field).xy_mm[0]
        assert same == pytest.approx(still, abs=1e-12)


def test_offsets_move_the_fibre_beside_the_star(tmp_path, field):
    plain = "target_id,ra,dec,fibre,delta_ra,delta_dec\na,213.7,53.0,BOSS,{},{}\n"
    here, east, north = (
        read_targets(write(tmp_path / "a.csv", plain.format(*by)), field).xy_mm[0]
        for by in ((0, 0), (2, 0), (0, 2))
    )
    assert 1e3 * (east - here) == pytest.approx([122.0, 0.0], abs=1.5)
    assert 1e3 * (north - here) == pytest.approx([0.0, 122.0], abs=1.5)


def test_the_middle_of_the_exposure_is_the_default(tmp_path, field):
    path = write(tmp_path / "a.csv", LIST)
    middle = read_targets(path, field).xy_mm
    begin = read_targets(path, write(tmp_path / "g.toml", FIELD + 'place_for = "begin"\n')).xy_mm
    later = FIELD.replace("06:00:00", "06:07:30").replace("900.0", "0.0")
    assert middle == pytest.approx(read_targets(path, write(tmp_path / "g.toml", later)).xy_mm, abs=1e-9)
    assert np.abs(middle - begin).max() > 1e-5


def test_a_confsummary_by_its_sky_columns_is_its_xwok_and_ywok(shared_sdssv):
    path = shared_sdssv / "confSummary-test.par.gz"
    found, field = read_sky(path)
    sky, flat = found.placed(field.chain(load_instrument("sdssv"))), read_targets(path)
    rows = [flat.target_id.tolist().index(name) for name in sky.target_id]
    assert len(sky) == 490
    assert (flat.fibre[rows] == sky.fibre).all()
    assert (flat.positioner_id[rows] == sky.positioner_id).all()
    assert 1e3 * np.abs(flat.xy_mm[rows] - sky.xy_mm).max() < 0.005
    assert rows == sorted(rows)


HEAD = "target_id,ra,dec,pmra,pmdec,epoch,wavelength\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("target_id,ra,dec\na,1,95\n", "line 2: dec = 95: must be -90 to 90 deg"),
        ("target_id,ra,dec\na,361,5\n", "line 2: ra = 361: must be 0 to 360 deg"),
        ("target_id,ra,dec\na,,5\n", "line 2: ra = '' is not a number"),
        ("target_id,ra,dec\na,-999,5\n", "line 2: ra = -999: a target has a place"),
        ("ra,dec\n1,5\n", "no column target_id or source_id or catalogid"),
        ("target_id,ra,dec\na,1,5\na,1,6\n", "line 3: target_id = a was used before, in line 2"),
        (HEAD + "a,213.7,53,10,0,,\n", "line 2: has a proper motion, but no epoch"),
        (HEAD + "a,213.7,53,10,0,20160,\n", "line 2: epoch = 20160: must be a Julian year"),
        (HEAD + "a,213.7,53,,,,0.54\n", "line 2: wavelength = 0.54: must be in Angstrom"),
        ("target_id,ra,dec,fibre\na,213.7,53,RED\n", "line 2: target a asks for fibre 'RED'; there are BOSS"),
        ("target_id,ra,dec\na,213.7,53\nb,213.7,57\n", "line 3: target b is 3.916 deg from the centre"),
        ("target_id,ra,dec\na,30,-60\n", "below the horizon at 2024-04-26T06:07:30.000 UTC"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_list_and_where(tmp_path, field, text, words):
    with pytest.raises(InputError) as caught:
        read_targets(write(tmp_path / "bad.csv", text), field)
    assert "bad.csv" in str(caught.value)
    assert words in str(caught.value)


def test_a_list_in_mm_has_no_field(tmp_path, field):
    with pytest.raises(InputError, match="no columns ra and dec; the columns are target_id, x_mm, y_mm"):
        read_targets(write(tmp_path / "a.csv", "target_id,x_mm,y_mm\na,1,2\n"), field)


def test_a_field_low_in_the_sky(tmp_path, field):
    late = write(tmp_path / "late.toml", FIELD.replace("06:00:00", "14:00:00"))
    with pytest.raises(InputError, match=r"line 2: target a is 1\d\.\d deg high .* too low \(and 1 more\)"):
        read_targets(write(tmp_path / "a.csv", LIST), late)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('time_scale = "utc"', ""), ["time_scale: is missing; it is utc, tai or tt"]),
        (('"utc"', '"local"'), ["time_scale = 'local'", "'utc', 'tai' or 'tt'"]),
        (("53.08333", "153.0"), ["dec_deg = 153.0: Input should be less than or equal to 90"]),
        (('"2024-04-26T06:00:00"', '"yesterday"'), ["time = 'yesterday': must be as 2024-04-26T06:00:00"]),
        (("exposure_s", "exposure"), ["exposure = 900.0: Extra inputs are not permitted"]),
        (("exposure_s", 'site = "apo"\nweather = { pressure_hPa = 5000 }\nexposure_s'),
         ["weather.pressure_hPa = 5000", "weather.humidity: Field required", "3 problems"]),
    ],
)  # fmt: skip
def test_all_that_is_wrong_with_a_field_file_is_told(tmp_path, change, words):
    with pytest.raises(InputError) as caught:
        SkyField.read(write(tmp_path / "f.toml", FIELD.replace(*change)))
    assert "f.toml" in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_sites_by_name_and_by_coordinates(tmp_path):
    model = load_instrument("sdssv")
    named = SkyField.read(write(tmp_path / "f.toml", FIELD + 'site = "APO"\n')).chain(model)
    own = "[site]\nlongitude_deg = -105.820278\nlatitude_deg = 32.766666667\nheight_m = 2788.0\n"
    there = SkyField.read(write(tmp_path / "g.toml", FIELD + own)).chain(model)
    assert there.altitude_deg == pytest.approx(named.altitude_deg, abs=1e-6)
    with pytest.raises(InputError, match=r"h\.toml: site 'moon': sdssv is at apo, lco"):
        read_targets(
            write(tmp_path / "a.csv", LIST), write(tmp_path / "h.toml", FIELD + 'site = "moon"\n'), model
        )


def test_a_time_of_toml_is_a_time(tmp_path):
    quoted = SkyField.read(write(tmp_path / "f.toml", FIELD))
    bare = SkyField.read(
        write(tmp_path / "g.toml", FIELD.replace('"2024-04-26T06:00:00"', "2024-04-26T06:00:00"))
    )
    assert bare.begin == quoted.begin
    for same in ("2024-04-26T06:00:00Z", "2024-04-26T08:00:00+02:00"):
        zoned = FIELD.replace('"2024-04-26T06:00:00"', same)
        assert SkyField.read(write(tmp_path / "i.toml", zoned)).begin == quoted.begin
    julian = FIELD.replace('"2024-04-26T06:00:00"', "2460426.75")
    assert abs(SkyField.read(write(tmp_path / "h.toml", julian)).begin.after_s(quoted.begin)) < 1e-4


def test_the_weather_counts(tmp_path, field):
    path = write(tmp_path / "a.csv", LIST)
    air = "weather = { pressure_hPa = 700.0, temperature_C = -5.0, humidity = 0.1 }\n"
    cold = read_targets(path, write(tmp_path / "cold.toml", FIELD + air))
    assert np.abs(cold.xy_mm - read_targets(path, field).xy_mm).max() > 1e-5


@pytest.mark.parametrize("column", ["fibre", "role"])
def test_guide_stars_stand_beside_the_targets(tmp_path, field, column):
    rows = ["a,213.7,53.1,", "g1,214.9,53.1,guide", "b,213.7,53.0,", "g2,213.7,59.0,guide"]
    (tmp_path / "stars.csv").write_text(f"target_id,ra,dec,{column}\n" + "\n".join(rows) + "\n")
    found = read_targets(tmp_path / "stars.csv", field)
    assert found.target_id.tolist() == ["a", "b"]
    # one that is far outside is no error: it is not seen
    assert found.on_sky.guides.target_id.tolist() == ["g1", "g2"]
    chain = found.on_sky.chain
    assert chain.place(found.on_sky.guides).xy_mm == pytest.approx(
        chain.place(found.on_sky.guides, "metrology").xy_mm
    )
    assert found.select(np.array([True, False])).on_sky.guides is not None


def test_a_list_of_guide_stars_alone(tmp_path, field):
    (tmp_path / "stars.csv").write_text("target_id,ra,dec,role\na,213.7,53.1,guide\n")
    with pytest.raises(InputError, match=r"stars\.csv: all 1 rows are guide stars; name targets too"):
        read_targets(tmp_path / "stars.csv", field)
