"""An hour at airmass 1.4 with a full field of SDSS-V: twelve exposures, fibres re-positioned between.

`python -m benchmarks.sky.series [--errors pointing] [--out DIR]` writes a list of stars and a field file into
DIR, then runs `fiberloom observe` on them. Minutes; the first time some more, for the twin's calibration.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np

RA_DEG, DEC_DEG, RADIUS_DEG, N = 166.79162422433734, 0.0, 1.42, 1500
EXPOSURES, EXPOSURE_S = 12, 300.0
FIELD = f"""ra_deg = {RA_DEG}
dec_deg = {DEC_DEG}
time = "2024-04-26T05:35:00"
time_scale = "utc"
exposure_s = {EXPOSURE_S}
"""


def stars() -> str:
    """A list with Gaia's names of columns."""
    rng = np.random.default_rng(1)
    lines = ["source_id,ra,dec,pmra,pmdec,parallax,ref_epoch,fibre,priority"]
    for k in range(N):
        turn = rng.uniform(0, 2 * np.pi)
        off = RADIUS_DEG * np.sqrt(rng.random())
        ra = RA_DEG + off * np.cos(turn) / np.cos(np.radians(DEC_DEG))
        place = f"{ra:.8f},{DEC_DEG + off * np.sin(turn):.8f}"
        motion = f"{rng.normal(0, 10):.3f},{rng.normal(0, 10):.3f},{rng.random():.3f},2016.0"
        lines.append(f"{k + 1},{place},{motion},{rng.choice(['BOSS', 'APOGEE', ''])},{rng.integers(1, 5)}")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/bench/series"))
    parser.add_argument("--errors", default="none", help="of the twin, as observe takes them")
    asked = parser.parse_args()
    folder = asked.out
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stars.csv").write_text(stars())
    (folder / "field.toml").write_text(FIELD)
    words = ["observe", "stars.csv", "--field", "field.toml", "--camera", "noise", "--errors", asked.errors]
    words += ["--out", "observed" if asked.errors == "none" else "guided"]
    command = [sys.executable, "-m", "fiberloom.cli", *words, "--exposures", str(EXPOSURES)]
    return subprocess.run(command, cwd=folder, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
