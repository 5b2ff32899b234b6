"""What is off for all fibres alike: the camera's frame, found from several fields; what a guider takes."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table
from stars import GAUSSIAN, Conditions, drawn_field, drawn_offsets, rms

import fiberloom as fl
from fiberloom.calibration.fibres.combine import combine
from fiberloom.calibration.fibres.estimate import estimate
from fiberloom.calibration.fibres.frame import (
    FAR_UM,
    FRAME_UM,
    OF_CAMERA,
    TERMS,
    FrameOffset,
    _sum,
    radius_of,
)
from fiberloom.calibration.fibres.guider import guided
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.errors import InputError
from fiberloom.studies.star_fields import stars as stars_of

MARKS = {"version": "0", "seed": 0, "instrument": "sdssv", "config_hash": "cafe", "utc": "2026-01-01"}
RADIUS_MM = 425.0
"""All of the square in which fields are drawn."""
N = 240


def drawn_frame(seed, each_um, far_um=0.5):
    """Sizes of the terms of a camera, and of those beyond."""
    rng = np.random.default_rng(seed)
    rms_um = np.where(np.arange(len(TERMS)) < OF_CAMERA, each_um, far_um)
    return FrameOffset(RADIUS_MM, rms_um * rng.standard_normal(len(TERMS)), np.eye(len(TERMS)))


def drawn_night(frame, seed=5, n=3):
    """Fields whose fibres are believed where the camera has them: off by the frame."""
    rng = np.random.default_rng(seed)
    offset = drawn_offsets(rng, N, rms_um=10.0)
    fields = []
    for k in range(n):
        true = drawn_field(rng, offset, Conditions(guide_um=2.0), name=f"field {k}")
        seen_mm = true.fibre_mm - frame.at_mm(true.fibre_mm)
        # the loop has put the fibre, as the camera has it, on the star; so the star is off from the truth
        fields.append(replace(true, fibre_mm=seen_mm))
    return offset, [estimate(f, GAUSSIAN) for f in fields]


@pytest.fixture(scope="module")
def frame():
    return drawn_frame(1, 2.0)


@pytest.fixture(scope="module")
def night(frame):
    return drawn_night(frame)


def test_the_frame_of_the_camera_is_found_with_its_error(frame, night):
    found = combine(night[1], radius_mm=RADIUS_MM).frame
    sigma = np.sqrt(np.diag(found.covariance_um2))
    assert sigma.max() < 0.5
    assert np.abs((found.size_um - frame.size_um) / sigma).max() < 4.0
    assert rms(found.size_um - frame.size_um) < 0.15 * frame.rms_um


def test_offsets_are_as_good_as_with_a_right_frame(night):
    """And not at all so where the frame is taken for right."""
    offset, fields = night
    none = drawn_frame(1, 0.0, 0.0)
    right, right_fields = drawn_night(none)
    error = rms(combine(fields, radius_mm=RADIUS_MM).offset_um - offset)
    assert error < 1.2 * rms(combine(right_fields, radius_mm=RADIUS_MM).offset_um - right)
    blind = [replace(f, turned=np.zeros_like(f.turned)) for f in fields]
    assert rms(combine(blind, radius_mm=RADIUS_MM).offset_um - offset) > 2.0 * error


def test_what_the_lens_bends_beyond_the_terms_of_a_camera_is_found():
    """A field that is smooth over 150 mm, as a lens in the cold makes it, without what 34 terms take."""
    frame = drawn_frame(1, 0.0, 1.0)
    offset, fields = drawn_night(frame)
    found = combine(fields, radius_mm=RADIUS_MM)
    none, right_fields = drawn_night(drawn_frame(1, 0.0, 0.0))
    right = rms(combine(right_fields, radius_mm=RADIUS_MM).offset_um - none)
    error = rms(found.offset_um - offset)
    print(f"{frame.rms_um:.1f} um beyond 34 terms: offsets {error:.2f} um, else {right:.2f}")
    assert rms(found.frame.size_um - frame.size_um) < 0.3 * frame.rms_um
    assert error < 1.2 * right


def test_a_frame_that_is_far_worse_than_expected_is_not_held_back():
    frame = drawn_frame(1, 15.0, 5.0)
    found = combine(drawn_night(frame)[1], radius_mm=RADIUS_MM).frame
    assert rms(found.size_um - frame.size_um) < 0.05 * frame.rms_um


def test_fields_together_do_not_scatter_by_a_wrong_frame(night):
    assert combine(night[1], radius_mm=RADIUS_MM).place_um < 0.8


def test_a_right_frame_is_not_made_wrong():
    found = combine(drawn_night(drawn_frame(1, 0.0, 0.0))[1], radius_mm=RADIUS_MM).frame
    assert found.rms_um < 0.6


def test_one_field_tells_no_frame_and_says_so(night):
    """Offsets fixed to the arms and a field fixed in the plane are one vector per fibre there."""
    found = combine(night[1][:1], radius_mm=RADIUS_MM).frame
    unknown = np.where(np.arange(len(TERMS)) < OF_CAMERA, FRAME_UM, FAR_UM)
    assert np.sqrt(np.diag(found.covariance_um2)) == pytest.approx(unknown, rel=1e-3)


# file and use


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("sdssv", seed=0, n=19)


def offsets_with(plane, frame):
    n = len(plane)
    fibre, wide = np.full(n, "BOSS"), np.tile(1e-6 * np.eye(2), (n, 1, 1))
    return FibreOffsets(plane.positioner_id, fibre, np.zeros((n, 2)), wide, frame=frame)


def test_fibres_that_are_seen_at_the_aims_are_on_their_targets(plane, frame):
    targets = fl.TargetList(
        target_id=np.array(["a", "b"]),
        x_mm=np.array([200.0, -30.0]),
        y_mm=np.array([-100.0, 60.0]),
        priority=np.ones(2),
        fibre=np.array(["BOSS", ""]),
        positioner_id=np.full(2, -1),
    )
    aims = offsets_with(plane, frame).aims(targets)
    seen_mm = np.column_stack([aims.x_mm, aims.y_mm])
    true_mm = seen_mm + frame.at_mm(seen_mm)
    assert true_mm == pytest.approx(np.column_stack([targets.x_mm, targets.y_mm]), abs=1e-6)
    assert np.abs(aims.x_mm - targets.x_mm).max() > 1e-4
    assert offsets_with(plane, None).aims(targets) is targets


def test_an_observation_with_a_frame_ends_where_the_frame_says(tmp_path):
    """This twin's frame is right, so one that the host takes off puts each fibre beside its star by it."""
    plane = fl.FocalPlane.of("sdssv", n=7)
    small = FrameOffset(45.0, 12.0 * np.eye(len(TERMS))[0], 1e-2 * np.eye(len(TERMS)))
    offsets_with(plane, small).write(tmp_path / "fibres.ecsv", MARKS)
    targets = stars_of(plane, "BOSS", 3)
    fl.Field.twin(plane, 0, camera="noise").run.calibrate(points=60).save(tmp_path / "maps.npz")
    field = fl.Field.twin(plane, 0, camera="noise", calibration=tmp_path / "maps.npz")
    seen = field.run.observe(targets, 2, out=tmp_path, fibres=tmp_path / "fibres.ecsv")
    star_mm = np.column_stack([targets.x_mm, targets.y_mm])[seen.assignment.target]
    off_um = 1e3 * (seen.final.true_mm - star_mm)
    by_frame_um = -1e3 * small.at_mm(star_mm)
    assert rms(by_frame_um) > 5.0
    assert rms(off_um - by_frame_um) < 2.0


def test_the_frame_comes_back_from_the_file(plane, frame, tmp_path):
    offsets_with(plane, frame).write(tmp_path / "a.ecsv", MARKS)
    read = FibreOffsets.load(tmp_path / "a.ecsv").frame
    assert read.size_um == pytest.approx(frame.size_um, abs=0.0)
    assert (read.radius_mm, read.covariance_um2.tolist()) == (RADIUS_MM, frame.covariance_um2.tolist())


def changed(path, of_head):
    """The same file with another head."""
    table = Table.read(path)
    table.meta |= of_head(table.meta)
    table.write(path, overwrite=True)


def test_a_file_of_format_1_has_the_numbers_of_the_frame_one_by_one(plane, frame, tmp_path):
    path = tmp_path / "a.ecsv"
    offsets_with(plane, frame).write(path, MARKS)
    changed(path, lambda head: {"format_version": 1, "camera_frame": frame.to_meta()})
    read = FibreOffsets.load(path).frame
    assert read.size_um.tolist() == frame.size_um.tolist()
    assert read.covariance_um2.tolist() == frame.covariance_um2.tolist()


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", "true"])
def test_a_text_that_is_no_frame_is_refused(text):
    with pytest.raises(InputError, match="camera frame: "):
        FrameOffset.of_text(text)


def test_a_file_from_before_the_terms_beyond_a_cameras_is_read(frame):
    meta = frame.to_meta()
    older = {name: meta[name] for name in ("terms", "radius_mm", "size_um", "covariance_um2")}
    older["terms"], older["size_um"] = older["terms"][:OF_CAMERA], older["size_um"][:OF_CAMERA]
    older["covariance_um2"] = [row[:OF_CAMERA] for row in older["covariance_um2"][:OF_CAMERA]]
    read = FrameOffset.of_meta(older | {"sum": _sum(older)})
    assert read.size_um[:OF_CAMERA] == pytest.approx(frame.size_um[:OF_CAMERA], abs=0.0)
    assert not read.size_um[OF_CAMERA:].any()
    assert np.diag(read.covariance_um2)[OF_CAMERA:] == pytest.approx(FAR_UM**2)


def test_a_frame_that_was_changed_in_the_file_is_refused(plane, frame, tmp_path):
    path = tmp_path / "a.ecsv"
    offsets_with(plane, frame).write(path, MARKS)
    changed(path, lambda head: {"camera_frame": head["camera_frame"].replace("425.0", "525.0", 1)})
    with pytest.raises(InputError, match=r"a.ecsv: camera frame: its numbers are not as they were written"):
        FibreOffsets.load(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"radius_mm": 0.0}, "radius"),
        ({"size_um": np.full(len(TERMS), np.nan)}, "53 sizes"),
        ({"size_um": np.zeros(9)}, "53 sizes"),
        ({"covariance_um2": -np.eye(len(TERMS))}, "covariance"),
        ({"covariance_um2": np.full((53, 53), np.nan)}, "covariance"),
    ],
)
def test_a_frame_that_cannot_be_is_refused(frame, change, said):
    with pytest.raises(InputError, match=said):
        replace(frame, **change)


def test_nights_are_weighed_by_what_they_know(frame):
    other = replace(frame, size_um=frame.size_um + 1.0, covariance_um2=3.0 * np.eye(53))
    both = FrameOffset.mean([frame, other])
    assert both.size_um == pytest.approx(frame.size_um + 0.25)
    assert both.covariance_um2 == pytest.approx(0.75 * np.eye(53))
    with pytest.raises(InputError, match="different layouts"):
        FrameOffset.mean([frame, replace(frame, radius_mm=400.0)])


def test_the_disc_holds_all_fibres(plane):
    reach_mm = max(np.hypot(*plane.forward(alpha, 0.0).T).max() for alpha in range(0, 360, 10))
    assert radius_of(plane) >= reach_mm


# the guider


def field_of_errors(seed=0, n=80):
    rng = np.random.default_rng(seed)
    return rng.uniform(-300.0, 300.0, (n, 2)), rng.normal(0.0, 1.0, (n, 2))


def test_shift_rotation_and_scale_are_the_guiders():
    xy_mm, error = field_of_errors()
    turned = xy_mm @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    off = error + [3.0, -5.0] + 0.02 * turned + 0.01 * xy_mm
    everyone = np.ones(len(xy_mm), dtype=bool)
    assert guided(off, xy_mm, everyone) == pytest.approx(guided(error, xy_mm, everyone), abs=1e-9)
    assert rms(guided(off, xy_mm, everyone)) < rms(error)


def test_other_fields_are_not_the_guiders(frame):
    xy_mm, _ = field_of_errors()
    off = 1e3 * frame.at_mm(xy_mm)
    assert rms(guided(off, xy_mm, np.ones(len(xy_mm), dtype=bool))) > 0.7 * rms(off)


def test_a_lone_fibre_that_is_far_off_does_not_move_the_telescope():
    xy_mm, error = field_of_errors()
    everyone = np.ones(len(xy_mm), dtype=bool)
    far = error.copy()
    far[5] += [300.0, 0.0]
    others = np.arange(len(xy_mm)) != 5
    assert guided(far, xy_mm, everyone)[others] == pytest.approx(
        guided(error, xy_mm, everyone & others)[others], abs=1e-9
    )
    assert guided(far, xy_mm, everyone)[5, 0] > 290.0


def test_two_fibres_guide_nothing():
    xy_mm, error = field_of_errors()
    counted = np.arange(len(xy_mm)) < 2
    assert np.array_equal(guided(error, xy_mm, counted), error)


def test_an_empty_field_is_guided_by_nothing():
    nothing = np.empty((0, 2))
    assert guided(nothing, nothing, np.empty(0, dtype=bool)).shape == (0, 2)
