"""What a positioner finds out by itself: hall sensors (command 26) and cogging (47)."""

from __future__ import annotations

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results
from fiberloom.bus.protocol import Command, Status
from fiberloom.instruments import FocalPlane

MARGIN_DEG = 60
"""Of the collision watch, motor degrees, while the firmware does not know its unit yet: a wrong cogging
phase alone is 2 x 10 uNm beyond the model."""
_LONGEST_S = 120.0
_HALL = Status.MOTOR_ALPHA_CALIBRATED | Status.MOTOR_BETA_CALIBRATED
_COGGING = Status.COGGING_ALPHA_CALIBRATED | Status.COGGING_BETA_CALIBRATED
_DATUMS = Status.DATUMS_INITIALIZED


async def calibrate_itself(client: Client, plane: FocalPlane, ids: list[int]) -> dict[int, str]:
    """Hall sensors, then cogging in the middle of the range, all positioners at once; not saved.

    By positioner why it failed, empty where it did not. Datums must be known.
    """
    trouble = dict.fromkeys(ids, "")
    await _need(client, trouble, _DATUMS, "its datums are not known; find them (20) before")
    await _ask(client, trouble, Command.SET_INCREASE_COLLISION_MARGIN, MARGIN_DEG)
    await _calibrate(client, trouble, Command.START_MOTOR_CALIBRATION, _HALL, "hall calibration")
    await _go_to_middle(client, plane, trouble)
    await _calibrate(client, trouble, Command.START_COGGING_CALIBRATION, _COGGING, "cogging calibration")
    await _ask(client, trouble, Command.SET_INCREASE_COLLISION_MARGIN, 0)
    return trouble


def _left(trouble: dict[int, str]) -> list[int]:
    return [i for i, t in trouble.items() if not t]


def _book(trouble: dict[int, str], results: Results, what: str) -> None:
    for i, result in results.failed.items():
        trouble[i] = trouble[i] or f"{what}: {str(result).partition(': ')[2]}"


async def _ask(client: Client, trouble: dict[int, str], command: Command, value: int) -> None:
    _book(trouble, await client.command(command, _left(trouble), value), command.name)


async def _calibrate(
    client: Client, trouble: dict[int, str], command: Command, bits: Status, what: str
) -> None:
    begun = await client.command(command, _left(trouble))
    _book(trouble, begun, what)
    ended = await client.wait_until_done(begun.ok_ids, _LONGEST_S, stop_on_collision=False)
    _book(trouble, ended, what)
    await _need(client, trouble, bits, f"{what}: it found nothing to go by")


async def _need(client: Client, trouble: dict[int, str], bits: Status, otherwise: str) -> None:
    for i, answer in (await client.status(_left(trouble))).items():
        if not answer.ok:
            trouble[i] = f"status: {str(answer).partition(': ')[2]}"
        elif Status(answer.values[0]) & bits != bits:
            trouble[i] = otherwise


async def _go_to_middle(client: Client, plane: FocalPlane, trouble: dict[int, str]) -> None:
    alpha, beta = (float(np.mean(limits)) for limits in plane.limits_deg)
    begun = await client.goto(_left(trouble), alpha, beta)
    _book(trouble, begun, "on the way to the middle")
    ended = await client.wait_until_done(begun.ok_ids, _LONGEST_S, stop_on_collision=False)
    _book(trouble, ended, "on the way to the middle")
