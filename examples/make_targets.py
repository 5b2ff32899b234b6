"""Make an example target list: uniform over the field, priorities 1 to 5, some for one fibre only.

python examples/make_targets.py examples/targets_sdssv.csv --instrument sdssv --n 1500 --seed 0
"""

import argparse
from pathlib import Path

from fiberloom.instruments import generate, load_instrument
from fiberloom.targets import random_targets, write_targets


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--instrument", default="sdssv")
    parser.add_argument("--n", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    plane = generate(load_instrument(args.instrument), args.seed)
    comments = (
        f"Random targets over the field of the preset {args.instrument}, made by",
        f"python examples/make_targets.py {args.path} --instrument {args.instrument} "
        f"--n {args.n} --seed {args.seed}",
        "fibre: empty means any science fibre; positioner_id: -1 means any positioner",
    )
    write_targets(random_targets(plane, args.n, args.seed), args.path, comments)


if __name__ == "__main__":
    main()
