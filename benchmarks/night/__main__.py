"""`python -m benchmarks.night [--kills 50] [--fields 5] [--positioners 37] [--seed 0] [--out FILE.json]`.

Nights on a twin that outlives the process which observes; that is killed (-9) at random instants and resumed,
until it was killed so often. Exit code 1 where anything was lost, doubled or touched.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import fiberloom as fl
from fiberloom.twin import draw_units

from .killed import Account, Scene, as_dict, killed_night, write_queue
from .world import FORK


def swept(plane: fl.FocalPlane, seed: int, file: Path) -> None:
    """Maps of the twin, in a process of its own: it has threads, and the night's processes are forked."""
    field = fl.Field.twin(plane, seed, camera="noise")
    field.run.calibrate().save(file)


def main() -> int:
    """Runs it; exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, value in (("kills", 50), ("fields", 5), ("positioners", 37), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--exposure", type=float, default=900.0, help="s")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    accounts: list[Account] = []
    while (left := asked.kills - sum(account.kills for account in accounts)) > 0 or not accounts:
        accounts.append(_one_night(asked, asked.seed + len(accounts), left))
    text = json.dumps([as_dict(account) for account in accounts], indent=1)
    print(text)
    if asked.out is not None:
        asked.out.write_text(text + "\n")
    return 0 if all(account.ok for account in accounts) else 1


def _one_night(asked: argparse.Namespace, seed: int, kills: int) -> Account:
    folder = Path(tempfile.mkdtemp(prefix="fiberloom-night-"))
    plane = fl.FocalPlane.of("sdssv", n=asked.positioners)
    sweep = FORK.Process(target=swept, args=(plane, asked.seed, folder / "maps.npz"))
    sweep.start()
    sweep.join()
    units = draw_units(plane, asked.seed)
    scene = Scene(plane, units, folder / "maps.npz", folder, asked.seed, asked.exposure)
    write_queue(scene, asked.fields)
    return killed_night(scene, kills, seed, lambda text: print(text, file=sys.stderr))


if __name__ == "__main__":
    sys.exit(main())
