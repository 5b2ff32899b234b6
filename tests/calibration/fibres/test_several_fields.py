"""Fields and nights together: the guider's patterns, weights, changed fibres; the file and the layout."""

from dataclasses import replace

import numpy as np
import pytest
from stars import GAUSSIAN, Conditions, drawn_field, drawn_offsets, formal, rms

import fiberloom as fl
from fiberloom.calibration.fibres.combine import combine
from fiberloom.calibration.fibres.dithered import DitheredField, hexagon
from fiberloom.calibration.fibres.estimate import estimate
from fiberloom.calibration.fibres.exposures_file import read_all, read_exposures, write_exposures
from fiberloom.calibration.fibres.frame import FAR_UM, FRAME_UM, OF_CAMERA, FrameOffset
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY
from fiberloom.tables import read_table

RADIUS_MM = 425.0
"""Of a disc that holds the square in which fields are drawn."""
MARKS = {"version": "0", "seed": 0, "instrument": "sdssv", "config_hash": "cafe", "utc": "2026-01-01"}


@pytest.fixture(scope="module")
def night():
    """Offsets (60, 2) um and three fields of them, with a guider that is off by 3 um as a whole."""
    rng = np.random.default_rng(1)
    offset = drawn_offsets(rng, 60, rms_um=4.0)
    fields = [drawn_field(rng, offset, Conditions(guide_um=2.0), name=f"field {k}") for k in range(3)]
    return offset, fields, [estimate(f, GAUSSIAN) for f in fields]


# together


def test_three_fields_tell_what_one_cannot(night):
    """The mean in the focal plane: in each field alone it is missing, together it is found."""
    offset, _, found = night
    alone = [rms(f.offset_um - offset) for f in found]
    together = combine(found, place_um=1e-3)
    assert rms(together.offset_um - offset) < 0.62 * np.mean(alone)
    told = formal(together.covariance_um2)
    assert 0.6 < rms(together.offset_um - offset) / told < 1.3
    assert (together.n_fields == 3).all()


def test_one_field_keeps_in_the_covariance_what_it_cannot_tell(night):
    """The guider's patterns, and a camera frame that is off."""
    _, _, (found, *_) = night
    one = combine([found], place_um=1e-3, radius_mm=RADIUS_MM)
    assert one.offset_um == pytest.approx(found.offset_um, abs=1e-4)
    frame = found.turned.swapaxes(-1, -2) @ FrameOffset.basis(found.fibre_mm, RADIUS_MM).transpose(1, 2, 0)
    guider_um2 = found.mode_um**2 + FRAME_UM**2
    expected = found.covariance_um2 + guider_um2 * found.modes @ found.modes.swapaxes(-1, -2)
    frame *= np.where(np.arange(frame.shape[-1]) < OF_CAMERA, FRAME_UM, FAR_UM)
    expected += frame @ frame.swapaxes(-1, -2)
    assert formal(one.covariance_um2) == pytest.approx(formal(expected), rel=1e-3)
    assert formal(one.covariance_um2) > 2.0 * formal(combine(night[2]).covariance_um2)


def shifted(found, row, by_um):
    offset = found.offset_um.copy()
    offset[row] += by_um
    return replace(found, offset_um=offset)


def test_the_field_that_disagrees_is_left_out(night):
    _, _, found = night
    right = combine(found)
    together = combine([found[0], shifted(found[1], 7, [30.0, 0.0]), found[2]])
    assert (together.n_fields[7], together.n_left_out[7]) == (2, 1)
    assert together.offset_um[7] == pytest.approx(right.offset_um[7], abs=1.5)
    others = np.arange(60) != 7
    assert together.offset_um[others] == pytest.approx(right.offset_um[others], abs=0.2)


def test_of_two_that_disagree_none_is_believed(night):
    _, _, found = night
    together = combine([found[0], shifted(found[1], 7, [30.0, 0.0])])
    assert "disagree" in together.reason[7]
    assert together.offset_um[7].tolist() == [0.0, 0.0]
    assert np.isnan(together.covariance_um2[7]).all()
    assert sum(map(bool, together.reason)) == 1


def test_places_that_scatter_more_are_told(night):
    """Metrology that is off by 4 um per coordinate in each field: found from the fields alone."""
    _, _, found = night
    rng = np.random.default_rng(3)
    noisy = [replace(f, offset_um=f.offset_um + rng.normal(0.0, 4.0, (60, 2))) for f in found]
    assert combine(noisy).place_um == pytest.approx(4.0, rel=0.25)
    assert formal(combine(noisy).covariance_um2) > 2.0 * formal(combine(found).covariance_um2)


def test_no_field_is_refused():
    with pytest.raises(InputError, match="no field"):
        combine([])


# the layout and the file


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("sdssv", seed=0, n=7)


def offsets_of(plane, offset_um, sigma_um=0.5):
    n = len(plane)
    lever = plane.points["BOSS"] - plane.points[METROLOGY]
    return FibreOffsets(
        positioner_id=plane.positioner_id,
        fibre=np.full(n, "BOSS"),
        offset_mm=1e-3 * np.broadcast_to(offset_um, (n, 2)),
        covariance_mm2=np.tile((1e-3 * sigma_um) ** 2 * np.eye(2), (n, 1, 1)),
        lever_mm=lever,
    )


def test_offsets_move_the_science_fibre_and_nothing_else(plane):
    moved = offsets_of(plane, [10.0, -4.0]).applied(plane)
    by = moved.forward(30.0, 0.0, "BOSS") - plane.forward(30.0, 0.0, "BOSS")
    angle = plane.alpha_off_rad + plane.beta_off_rad + np.deg2rad(30.0)
    expected = (0.010 - 0.004j) * np.exp(1j * angle)
    assert by == pytest.approx(np.column_stack([expected.real, expected.imag]), abs=1e-9)
    for other in set(plane.points) - {"BOSS"}:
        assert np.array_equal(moved.points[other], plane.points[other], equal_nan=True)


def test_offsets_are_not_applied_twice(plane):
    offsets = offsets_of(plane, [10.0, -4.0])
    with pytest.raises(InputError, match="once"):
        offsets.applied(offsets.applied(plane))


def test_a_longer_arm_does_not_matter(plane):
    """Arms may be calibrated after the stars: all fibres of an arm move alike."""
    offsets = offsets_of(plane, [10.0, -4.0])
    longer = replace(plane, points={name: xy + np.array([0.02, 0.0]) for name, xy in plane.points.items()})
    moved = offsets.applied(longer).points["BOSS"] - longer.points["BOSS"]
    assert moved == pytest.approx(np.tile([0.010, -0.004], (7, 1)))


def test_offsets_of_another_array_are_refused(plane):
    other = replace(plane, positioner_id=plane.positioner_id + 1000)
    with pytest.raises(InputError, match="none of the 7 positioners"):
        offsets_of(other, [1.0, 1.0]).applied(plane)


def test_nights_are_weighed(plane):
    both = FibreOffsets.combined([offsets_of(plane, [0.5, 0.0], 0.5), offsets_of(plane, [0.0, 0.0], 1.0)])
    assert both.offset_mm == pytest.approx(np.tile([0.4e-3, 0.0], (7, 1)), abs=1e-7)
    assert both.covariance_mm2[0] == pytest.approx(0.2e-6 * np.eye(2), rel=1e-3)
    assert both.n_fields.tolist() == [2] * 7


def test_a_fibre_that_changed_between_nights_is_told(plane):
    first, second = (offsets_of(plane, [x, 0.0]) for x in (0.0, 0.5))
    moved = second.offset_mm.copy()
    moved[2] += [0.020, 0.0]
    both = FibreOffsets.combined([first, replace(second, offset_mm=moved)])
    assert both.ok.tolist() == [k != 2 for k in range(7)]
    assert "nights disagree" in both.reason[2]


def test_the_file_comes_back(plane, tmp_path):
    made = offsets_of(plane, [3.0, 1.0])
    reason = np.array(["", "", "no light", "", "", "", ""])
    wide = np.where((reason != "")[:, None, None], np.nan, made.covariance_mm2)
    made = replace(made, reason=reason, covariance_mm2=wide)
    made.write(tmp_path / "fibres.ecsv", MARKS)
    read = FibreOffsets.load(tmp_path / "fibres.ecsv")
    for name in ("positioner_id", "offset_mm", "lever_mm", "n_fields", "covariance_mm2"):
        assert np.array_equal(getattr(read, name), getattr(made, name), equal_nan=True)
    assert read.fibre.tolist() == made.fibre.tolist()
    assert read.reason.tolist() == reason.tolist()
    assert read.applied(plane).points["BOSS"][2].tolist() == plane.points["BOSS"][2].tolist()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.003", "nan", "offset"),
        ("0.003", "3.0", "beyond"),
        ("0.003", "x", "cannot be read|not a number"),
        ("BOSS", "", ""),
    ],
)
def test_a_file_of_nonsense_is_refused(plane, tmp_path, old, new, said):
    path = tmp_path / "fibres.ecsv"
    offsets_of(plane, [3.0, 1.0]).write(path, MARKS)
    text = "\n".join(line for line in path.read_text().splitlines() if "rows_sum" not in line)
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=f"fibres.ecsv.*{said}"):
        FibreOffsets.load(path).applied(plane)


def test_a_file_that_was_cut_is_refused(plane, tmp_path):
    path = tmp_path / "fibres.ecsv"
    offsets_of(plane, [3.0, 1.0]).write(path, MARKS)
    path.write_text("\n".join(path.read_text().splitlines()[:-2]) + "\n")
    with pytest.raises(InputError, match="cut short"):
        FibreOffsets.load(path)


def test_a_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(InputError, match="fiberloom calibrate fibres"):
        FibreOffsets.load(tmp_path / "none.ecsv")


# recorded exposures


def test_exposures_come_back(night, tmp_path):
    _, (field, *_), _ = night
    flux = field.flux.copy()
    flux[3, 4] = np.nan
    write_exposures(tmp_path / "a.ecsv", replace(field, flux=flux), MARKS)
    read = read_exposures(tmp_path / "a.ecsv")
    assert np.array_equal(read.flux, flux, equal_nan=True)
    for name in ("positioner_id", "star_mm", "fibre_mm", "arm_deg", "dither_um"):
        assert np.array_equal(getattr(read, name), getattr(field, name))


def test_the_same_field_twice_is_refused(night, tmp_path):
    for name in ("a.ecsv", "b.ecsv"):
        write_exposures(tmp_path / name, night[1][0], MARKS)
    with pytest.raises(InputError, match=r"b.ecsv: holds the same fluxes as .*a.ecsv"):
        read_all([tmp_path / "a.ecsv", tmp_path / "b.ecsv"])


CHANGES = {
    "a dither of its own": ("dither_x_um", "17.5", "but 0 in line 2"),
    "another star": ("star_x_mm", "12.0", "star_x_mm"),
    "no error": ("flux_error", "0.0", "is not above 0"),
    "no number": ("flux", "bright", "is not a number"),
    "another fibre": ("fibre", "APOGEE", "other rows"),
    "twice": ("positioner_id", "1", ""),
}


@pytest.mark.parametrize("what", CHANGES)
def test_exposures_that_cannot_be_are_refused(night, tmp_path, what):
    name, cell, said = CHANGES[what]
    write_exposures(tmp_path / "a.ecsv", night[1][0], MARKS)
    table = read_table(tmp_path / "a.ecsv")
    columns = {key: [str(v) for v in values] for key, values in table.columns.items()}
    columns[name][1] = cell
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    (tmp_path / "b.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=f"b.csv, line (3|63): .*{said}"):
        read_exposures(tmp_path / "b.csv")


def test_a_star_far_from_its_fibre_is_refused(night):
    field = night[1][0]
    with pytest.raises(InputError, match="mm from its fibre"):
        replace(field, star_mm=field.star_mm + 2.0)


def test_a_positioner_twice_is_refused(night):
    field = night[1][0]
    with pytest.raises(InputError, match="twice"):
        replace(field, positioner_id=np.ones(60, np.int64))


def test_the_pattern_is_a_hexagon():
    xy = hexagon(45.0)
    far = np.hypot(*xy.T)
    assert far == pytest.approx([0.0, *[45.0] * 6, *[45.0 * np.sqrt(3.0)] * 6])
    assert xy.sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
    apart = np.hypot(*(xy[:, None] - xy[None]).T) + 1e9 * np.eye(13)
    assert apart.min(axis=0) == pytest.approx(45.0)
    assert isinstance(xy, np.ndarray)
    with pytest.raises(InputError, match="1 to 13"):
        hexagon(n=14)


def test_selected_fibres_keep_their_fluxes(night):
    field: DitheredField = night[1][0]
    part = field.select(np.array([4, 2]))
    assert np.array_equal(part.flux, field.flux[:, [4, 2]])
    assert part.positioner_id.tolist() == [5, 3]
