"""Motor maps of all cobras from a summary: by hand, hostile files, and the public one."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import twin_source
from fiberloom.drive.piezo import read_module_maps, read_summary_maps

NAMES = [f"{m}_{w}" for m in ("theta", "phi") for w in ("fwd", "rev")]


def arrays(cobras=3, bins=4):
    """Cobra k of module 2; a step tells cobra, motor, way and bin."""
    held = {"module": np.full(cobras, "SC02"), "positioner": np.arange(1, cobras + 1, dtype=np.int16)}
    for k, name in enumerate(NAMES):
        step = 0.01 * np.arange(1, cobras + 1)[:, None] + 0.001 * (k + 1) + 1e-4 * np.arange(bins)
        held[f"{name}_deg_per_step"] = step
        held[f"{name}_last_edge_deg"] = np.full(cobras, 400.0)
    return held


def written(folder, **changed):
    path = folder / "maps.npz"
    np.savez(path, **(arrays() | changed))
    return path


def test_each_cobra_has_its_own_steps(tmp_path):
    maps = read_summary_maps(written(tmp_path), np.array([60, 58]))
    assert maps.step_deg.shape == (4, 2, 4)
    assert maps.bin_deg == 100.0
    # phi of cobra 60, which is the third one of the file, in reverse, last bin
    assert maps.step_deg[1, 1, 3] == pytest.approx(0.03 + 0.004 + 3e-4)
    assert maps.step_deg[2, 0, 0] == pytest.approx(0.01 + 0.001)
    assert maps.pulse_us.tolist() == [[44.0, 44.0], [22.0, 22.0]] * 2


def test_pulses_of_the_table_beside_it(tmp_path):
    columns = [f"link{k}_{way}_ontime_ms_slow" for k in (1, 2) for way in ("fwd", "rev")]
    rows = ["0.030,0.031,0.020,0.021", "0.040,0.041,0,0.025", "0.050,0.051,0.030,0.029"]
    (tmp_path / "pfs_2394_cobras_scalars.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")
    pulse = read_summary_maps(written(tmp_path), np.array([59])).pulse_us
    # one motor has none: the median of the others
    assert pulse.tolist() == [[40.0, 41.0], [20.0, 25.0]]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"module": np.array(["SC02", "SC02", "other"])}, "no summary of motor maps"),
        ({"positioner": np.arange(2)}, "do not have the same 3 cobras"),
        ({"theta_fwd_deg_per_step": np.zeros((3, 4))}, "must be above 0"),
    ],
)
def test_other_files_are_refused(changed, said, tmp_path):
    with pytest.raises(fl.InputError, match=said):
        read_summary_maps(written(tmp_path, **changed), np.array([58, 59, 60]))


def test_a_cobra_that_is_not_in_it_and_files_that_are_none(tmp_path):
    with pytest.raises(fl.InputError, match="no motor map of cobra 7"):
        read_summary_maps(written(tmp_path), np.array([58, 7]))
    (tmp_path / "text.npz").write_text("no numbers")
    for name in ("text.npz", "none.npz"):
        with pytest.raises(fl.InputError, match=name):
            read_summary_maps(tmp_path / name, np.array([58]))


def test_a_field_takes_them_as_its_calibration(tmp_path):
    plane = fl.FocalPlane.of("pfs", n=3)
    module, place = np.divmod(plane.positioner_id - 1, 57)
    held = {"module": np.array([f"SC{m + 1:02}" for m in module]), "positioner": place + 1}
    source = twin_source(plane, 0, "noise", "")
    field = fl.Field(plane, source, 0, written(tmp_path, **held))
    field.run.calibrate()
    np.testing.assert_allclose(source.known_maps.step_deg[0, 0], 0.011 + 1e-4 * np.arange(4))
    desi = fl.FocalPlane.of("desi", n=3)
    other = fl.Field(desi, twin_source(desi, 0, "noise", ""), 0, tmp_path / "maps.npz")
    with pytest.raises(fl.InputError, match="no file of learnt maps"):
        other.run.calibrate()


def test_the_public_summary_says_what_the_file_of_module_3_says(shared_pfs):
    own = read_module_maps(shared_pfs / "SC03_final.xml.gz")
    summary = read_summary_maps(shared_pfs / "derived" / "pfs_2394_motor_maps_slow.npz", np.arange(115, 172))
    np.testing.assert_allclose(summary.step_deg, own.step_deg, rtol=5e-4)  # 16 bits
    assert np.abs(summary.pulse_us - own.pulse_us).max() <= 0.5  # whole us
