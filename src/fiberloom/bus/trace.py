"""The bench's oscilloscope: what the motors of positioners did, sample by sample (commands 240 to 246).

Firmware of this project only (docs/firmware.md): another answers UNKNOWN_COMMAND.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fiberloom import units
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results, results_of
from fiberloom.bus.protocol import Command
from fiberloom.errors import InputError
from fiberloom.typing import Floats, Ints

TRACE_SAMPLES = 1024
FULL_VOLTAGE = 32767
_OPEN = -32768
PUSH_TICKS = 400
"""Longest torque step in all."""
_DEG_PER_COUNT = units.GEAR / units.COUNTS_PER_DEG
_STATE = (Command.BENCH_TRACE_STATE_ALPHA, Command.BENCH_TRACE_STATE_BETA)
_READ = (Command.BENCH_TRACE_READ_ALPHA, Command.BENCH_TRACE_READ_BETA)
_STEP = (Command.BENCH_TORQUE_STEP_ALPHA, Command.BENCH_TORQUE_STEP_BETA)


@dataclass(frozen=True, eq=False)
class Trace:
    """One axis of n positioners; rows in the order of `positioner_id`, NaN beyond what each recorded."""

    positioner_id: Ints
    motor_deg: Floats
    """(n, M) motor angle at the start of each sample, zero at wire position zero."""
    voltage: Floats
    """(n, M) mean u_cmd / u_dc over the sample, its sign that of the torque (closed loop)."""
    period_s: float
    zero_deg: Floats
    """(n,) motor angle at which the rotor's own angle is zero."""

    @property
    def rotor_deg(self) -> Floats:
        """(n, M) the rotor's own angle, unwrapped."""
        return self.motor_deg - self.zero_deg[:, None]


async def start_trace(client: Client, ids: Iterable[int], period_s: float) -> Results:
    """Records both axes while they work, a sample every `period_s` (whole ticks of 0.5 ms)."""
    ticks = round(period_s / units.TICK_S)
    if not 1 <= ticks <= 65535:
        raise InputError(
            f"trace: a sample every {period_s} s; {units.TICK_S:g} to {65535 * units.TICK_S:g} s are possible"
        )
    return await client.command(Command.BENCH_TRACE_START, ids, ticks)


async def read_trace(client: Client, ids: Sequence[int], axis: int) -> Trace:
    """What axis 0 (alpha) or 1 (beta) of these positioners recorded; silent ones have nothing."""
    state = await client.command(_STATE[axis], ids)
    count, ticks, zero = state.values_array(3).T
    wanted = int(count.max(initial=0))
    out = np.full((2, len(ids), wanted), np.nan)
    for first in range(0, wanted, client.bite):
        await _read_bite(client, _READ[axis], ids, count, (first, min(first + client.bite, wanted)), out)
    return Trace(
        np.asarray(ids, dtype=np.int64),
        out[0] * _DEG_PER_COUNT,
        out[1] / FULL_VOLTAGE,
        float(ticks.max(initial=0)) * units.TICK_S,
        zero * _DEG_PER_COUNT,
    )


async def _read_bite(
    client: Client,
    command: Command,
    ids: Sequence[int],
    count: Ints,
    span: tuple[int, int],
    out: Floats,
) -> None:
    places = [(row, k) for row in range(len(ids)) for k in range(span[0], min(span[1], int(count[row])))]
    for _ in range(client.retries + 1):
        payloads = [k.to_bytes(2, "little") for _, k in places]
        asked = [ids[row] for row, _ in places]
        replies = await client.exchange.unicast(command, asked, payloads, 2.0)
        missing = []
        results = results_of(asked, command, replies, client.exchange.cut_off(asked))
        for (row, k), result in zip(places, results, strict=True):
            if result.ok:
                out[:, row, k] = result.values
            else:
                missing.append((row, k))
        if not (places := missing):
            return


async def push(
    client: Client,
    ids: Iterable[int],
    axis: int,
    voltages: tuple[float | None, float | None],
    times_s: tuple[float, float],
) -> Results:
    """Drive with one torque, then another, and let the motor stop.

    `ids`: positioners of the `client`; `axis`: 0 alpha, 1 beta; `voltages`: shares of the full voltage,
    -1 to 1, or None for an open bridge (a board that cannot answers UNKNOWN_COMMAND); `times_s`: how long
    each lasts, 0.2 s in all at most: up to 7 deg of the arm. No watch looks for collisions meanwhile.
    InputError for values beyond these limits.
    """
    level = [_OPEN if v is None else round(v * FULL_VOLTAGE) for v in voltages]
    ticks = [round(t / units.TICK_S) for t in times_s]
    if any(v is not None and abs(v) > 1.0 for v in voltages):
        raise InputError(f"torque step: voltages {voltages} must be shares of the full one, -1 to 1")
    if sum(ticks) > PUSH_TICKS:
        raise InputError(f"torque step: {sum(times_s):g} s; {PUSH_TICKS * units.TICK_S:g} s in all at most")
    return await client.command(_STEP[axis], ids, *level, *ticks)
