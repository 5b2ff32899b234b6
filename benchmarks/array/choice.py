"""How long does it take to choose who is stopped, while a gateway is cut and an arm has collided?

    python benchmarks/array/choice.py [--positioners N] [--seeds N]

Each seed is another field on its way from one random configuration to another; at three instants a
positioner has collided while one of six gateways is cut. Arms go on while the choice is made: it must end
within what it allows for, or it is made anew with more. Only the choice is timed, not the bus.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import sys
import time

import numpy as np

from fiberloom.bus.motion import Deviation, DeviationKind, Going
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.operation.safety.deviation import CHOOSING_S, STOPPING_S, STOPS, MotionRule
from fiberloom.planning import Plan, plan, random_pair

GATEWAYS = 6
INSTANTS = (0.1, 0.3, 0.6)
"""Shares of the motion's duration."""


def main() -> None:
    options = read_options()
    cpu_s, wall_s, touching = [], [], 0
    for seed in range(options.seeds):
        plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=options.positioners)
        planned = plan(plane, *random_pair(plane, seed), seed=seed)
        for share in INSTANTS:
            cpu, wall, contacts = timed(plane, planned, share * planned.duration_s, seed)
            cpu_s.append(cpu)
            wall_s.append(wall)
            touching += contacts > 0
    print(f"{len(cpu_s)} choices among {options.positioners} positioners, one of {GATEWAYS} gateways cut")
    print(f"CPU s: median {np.median(cpu_s):.3f}, largest {max(cpu_s):.3f}")
    late = np.sum(np.array(wall_s) > CHOOSING_S)
    print(f"s by the clock: median {np.median(wall_s):.3f}, largest {max(wall_s):.3f}")
    print(f"over {CHOOSING_S} s, and made anew: {late}; without a choice free of contacts: {touching}")


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=10)
    return parser.parse_args(sys.argv[1:])


def timed(plane: FocalPlane, planned: Plan, time_s: float, seed: int) -> tuple[float, float, int]:
    """CPU and wall s of one choice, and its contacts."""
    ids = plane.positioner_id.tolist()
    collided = int(np.random.default_rng([seed, 0xC0]).choice(ids))
    cut = frozenset(ids[seed % GATEWAYS :: GATEWAYS]) - {collided}
    going = Going(time_s, frozenset(ids) - cut - {collided}, cut)
    rule = MotionRule(plane, planned, lambda *_: None, time.monotonic, poll_s=math.inf)
    asyncio.run(rule.may_go_on([Deviation(collided, DeviationKind.COLLIDED, time_s, time_s - 0.1)]))
    began = time.process_time(), time.monotonic()
    choice = rule.best(going, time_s + np.linspace(0.0, CHOOSING_S + STOPPING_S, STOPS))
    return time.process_time() - began[0], time.monotonic() - began[1], len(choice.contacts)


if __name__ == "__main__":
    main()
