"""Every design command: what cannot be is one line with what is wrong, where, and what would do."""

from pathlib import Path

import pytest

DENSE = (Path(__file__).parents[2] / "examples" / "dense.toml").read_text()
CASES = [
    ("check bad.toml", "l_alpha_mm = 5.0", "l_alpha_mm = 0.0", "bad.toml: positioner.l_alpha_mm = 0.0"),
    ("coverage bad.toml", "x_mm = 5.0", "x_mm = 0.0", "fibre lies on the beta axis; give its x_mm a length"),
    (
        "coverage bad.toml",
        "l_alpha_mm = 5.0",
        "l_alpha_mm = 500.0",
        "make the arms shorter or the pitch wider",
    ),
    ("coverage sdssv --arms 5", "", "", "give two lengths in mm"),
    ("coverage sdssv --share 7/5", "", "", "as in 3/5"),
    ("gear sdssv --within 0.5", "", "", "the least time is 5.54 s; 5760.0 deg/s2 would do"),
    ("spring sdssv --load many", "", "", "give two torques in mNm"),
    ("spring moons", "", "", "moons: alpha is a stepper of gear 2050.18"),
    ("efficiency pfs --targets empty.csv", "", "", "empty.csv: no rows below the header"),
    ("efficiency pfs --fibre X", "", "", "fibre X: pfs has fibre"),
    ("survey pfs --targets empty.csv", "", "", "empty.csv: no rows below the header"),
    ("sweep sdssv --vary arms.gamma=1:2:1", "", "", "known are arms.alpha, arms.beta, pitch"),
    ("sweep nosuch --vary pitch=20", "", "", "neither a preset (desi, lamost, megara, moons, pfs, sdssv)"),
    ("sweep sdssv --vary pitch=22 --objectives beauty", "", "", "--objectives beauty: known are positioners"),
    ("compare sdssv nosuch", "", "", "instrument 'nosuch'"),
    ("budget sdssv --errors fog", "", "", "--errors fog: known are all, none, arm"),
    ("budget sdssv --focal-ratio 0", "", "", "focal ratio 0: must be 0.1 to 100"),
    ("power sdssv --limit 0.001", "", "", "one positioner takes 0.0385 W; give at least that"),
    ("power sdssv --every 0", "", "", "all positioners"),
    ("throughput sdssv --core 0 --scale 60", "", "", "core_um 0: must be above 0"),
    ("report nosuch", "", "", "instrument 'nosuch'"),
]


@pytest.mark.parametrize(("words", "good", "bad", "says"), CASES, ids=[case[0] for case in CASES])
def test_one_line_says_what_would_do(fl, tmp_path, monkeypatch, words, good, bad, says):
    monkeypatch.chdir(tmp_path)
    assert good in DENSE
    Path("bad.toml").write_text(DENSE.replace(good, bad) if good else DENSE)
    Path("empty.csv").write_text("target_id,x_mm,y_mm\n")
    code, _, said = fl("design", *words.split())
    assert code == 2
    last = said.strip().splitlines()[-1]
    assert last.startswith("fiberloom: ")
    assert says in last


def test_a_spring_without_a_window_says_what_opens_one(fl, monkeypatch):
    monkeypatch.setattr("fiberloom.design.spring.UNITS", 61)  # 500 take seconds to draw
    code, said, _ = fl("design", "spring", "sdssv", "--load", "30,5")
    assert code == 1
    assert "no window: the spring must exceed 60.00" in " ".join(said.split())
    assert "or more friction, opens it" in " ".join(said.split())
