"""Learnt states as bytes, one packet for each positioner, small enough to keep a history.

Kept are means and variances in single precision (1e-8 of a value: far below a micrometre at the
fibre) and the arms' joint covariance; correlations between the nodes of the maps are not, so that a
state that was read back is a little less sure of itself than the one that was written.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping

import numpy as np

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.calibration.adaptive.map_filter import N_ARMS, FilterState
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.typing import Ints

_MAGIC = b"FL01"


def origin(maps: TransmissionMaps, learner: AdaptiveCalibration) -> str:
    """16 hex digits of the calibration and the settings that states build on."""
    digest = hashlib.sha256(repr(learner.settings).encode())
    for values in (maps.positioner_id, maps.wire_deg, maps.output_deg, learner.given.arms):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def pack(learner: AdaptiveCalibration, index: Ints) -> dict[int, bytes]:
    """Packets of these rows, by positioner."""
    state = learner.state(index)
    return {
        int(p): _MAGIC + zlib.compress(_plain(state.filter, row), 1)
        for row, p in enumerate(state.positioner_id)
    }


def _plain(state: FilterState, row: int) -> bytes:
    covariance = state.covariance[row]
    parts = [
        state.mean[row],
        np.diag(covariance),
        covariance[:N_ARMS, :N_ARMS],
        [state.doubt[row]],
        state.ripple_deg[row],
        state.ripple_variance[row],
    ]
    return np.concatenate([np.ravel(p) for p in parts]).astype("<f4").tobytes()


def unpack(learner: AdaptiveCalibration, packets: Mapping[int, bytes], moves: Mapping[int, int]) -> None:
    """Puts packets back; positioners that are not in this focal plane are passed over."""
    known = {int(p): row for row, p in enumerate(learner.plane.positioner_id)}
    here = {p: data for p, data in packets.items() if p in known}
    if not here:
        return
    index = np.array([known[p] for p in here])
    state = learner.state(index)
    for row, (positioner, data) in enumerate(here.items()):
        _fill(state.filter, row, data, positioner)
        state.moves[row] = moves[positioner]
    learner.restore(state)


def _fill(state: FilterState, row: int, data: bytes, positioner: int) -> None:
    d, knots = state.mean.shape[1], state.ripple_deg[row].size
    sizes = [d, d, N_ARMS * N_ARMS, 1, knots, knots]
    try:
        if data[: len(_MAGIC)] != _MAGIC:
            raise ValueError("unknown format")
        plain = np.frombuffer(zlib.decompress(data[len(_MAGIC) :]), "<f4").astype(np.float64)
        mean, diagonal, arms, doubt, ripple, variance = np.split(plain, np.cumsum(sizes)[:-1])
        state.ripple_variance[row] = variance.reshape(state.ripple_deg[row].shape)
    except (ValueError, zlib.error) as error:
        raise InputError(
            f"what was learnt of positioner {positioner} cannot be read ({error}); "
            "go back to an earlier generation with 'fiberloom calibrate undo'"
        ) from None
    state.mean[row], state.doubt[row] = mean, int(doubt[0])
    state.covariance[row] = np.diag(diagonal)
    state.covariance[row, :N_ARMS, :N_ARMS] = arms.reshape(N_ARMS, N_ARMS)
    state.ripple_deg[row] = ripple.reshape(state.ripple_deg[row].shape)
