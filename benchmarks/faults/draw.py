"""What goes wrong in one seed: one to four kinds of faults, their victims, times and sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.typing import Ints

HIDDEN = ("lying", "broken_arm")
"""No reply tells of these: only an image can."""
OF_POSITIONERS = ("dark", "dead", "false_start", "mute", "reboot", "stuck_hall", *HIDDEN)
OF_THE_CAMERA = ("camera_hang", "camera_error", "camera_half", "camera_stale")
KINDS = (*OF_POSITIONERS, "lost", "cut", *OF_THE_CAMERA, "disk_full", "kill")

SCHEDULED = ("dark", "dead", "lying", "mute", "reboot", "stuck_hall")
"""Kinds of the twin's own grammar."""

LAST_S = 36.0
"""Faults begin before that: in the first command or soon after it."""


@dataclass(frozen=True)
class Injected:
    """One fault of one seed."""

    kind: str
    positioner_id: int = 0
    at_s: float = 0.0
    """In the twin's time; of a camera fault: the number of its first image."""
    size: float = 0.0
    """false_start: deg; broken_arm: share of the way; lost: share of the replies; cut: s; camera: images;
    disk_full: bytes left; kill: s of real time later."""
    axis: int = 0


@dataclass(frozen=True)
class Scene:
    """A seed and all that goes wrong in it."""

    seed: int
    faults: tuple[Injected, ...]

    def of(self, *kinds: str) -> list[Injected]:
        """Its faults of these kinds."""
        return [fault for fault in self.faults if fault.kind in kinds]

    def text(self) -> str:
        """For `--faults`: what the twin's grammar knows."""
        parts = [f"{f.kind}=#{f.positioner_id}@{f.at_s:.3f}" for f in self.of(*SCHEDULED)]
        return ",".join(parts + [f"lost={f.size:.4f}@{f.at_s:.3f}" for f in self.of("lost")])


def draw(seed: int, ids: Ints) -> Scene:
    """One to four kinds; of a kind of positioners one or two `ids`, nobody has two faults."""
    rng = np.random.default_rng([seed, 0xFC])
    kinds = rng.choice(KINDS, size=rng.integers(1, 5), replace=False)
    free = rng.permutation(ids).tolist()
    faults: list[Injected] = []
    for kind in kinds.tolist():
        count = int(rng.integers(1, 3)) if kind in OF_POSITIONERS else 1
        faults += [_one(kind, rng, free) for _ in range(count)]
    return Scene(seed, tuple(faults))


def _one(kind: str, rng: np.random.Generator, free: list[int]) -> Injected:
    at_s = 0.0 if rng.random() < 0.25 or kind == "false_start" else float(rng.uniform(0.0, LAST_S))
    size, axis = _size(kind, rng), int(rng.integers(2))
    if kind in OF_THE_CAMERA:
        at_s = float(rng.integers(0, 9))
    if kind == "kill":
        at_s = float(rng.uniform(0.0, 0.9 * LAST_S))
    return Injected(kind, free.pop() if kind in OF_POSITIONERS else 0, at_s, size, axis)


def _size(kind: str, rng: np.random.Generator) -> float:
    if kind in OF_THE_CAMERA:
        return float(rng.integers(1, 9))
    low, high = {
        "false_start": (3.0, 180.0),
        "broken_arm": (0.0, 0.9),
        "lost": (0.001, 0.03),
        "cut": (1.0, 20.0),
        "disk_full": (0.0, 3e5),
        "kill": (0.0, 0.3),
    }.get(kind, (0.0, 0.0))
    return float(rng.uniform(low, high))
