"""Arms of `calibrate focal-plane` in an observation: a blind move lands where they say."""

import fiberloom as fl
from fiberloom.calibration.focal_plane import arms_file
from fiberloom.operation.survey import SurveySettings
from fiberloom.studies.star_fields import stars

PLANE = fl.FocalPlane.of("sdssv", n=7)


def test_a_blind_move_by_calibrated_arms_does_not_see_that_the_table_is_wrong(tmp_path, monkeypatch):
    """Three times the errors of a table are some 50 um; maps and seats leave 10. The file is read once."""
    maps = tmp_path / "maps.npz"
    fl.Field.twin(PLANE, 0, camera="noise").run.calibrate(points=60).save(maps)
    field = fl.Field.twin(PLANE, 0, camera="noise", errors="arm=3", calibration=maps)
    field.run.survey(SurveySettings(8, seed=0), out=tmp_path / "arms").save(tmp_path / "arms")

    read, read_ecsv = [], arms_file.read_ecsv
    monkeypatch.setattr(arms_file, "read_ecsv", lambda path: read.append(path.name) or read_ecsv(path))

    def blind_um(name, **known):
        seen = field.run.observe(stars(PLANE, "BOSS", 7), 0, out=tmp_path / name, **known)
        return seen.summary()["moves"][0]["measured_rms_um"]

    by_table, calibrated = blind_um("table"), blind_um("file", arms=tmp_path / "arms" / "arms.ecsv")
    assert by_table > 30.0
    assert calibrated < 0.6 * by_table
    assert calibrated < 20.0
    assert read == ["arms.ecsv"]
