"""Looking while arms are out: no image is an alarm, and another one is asked for; nothing moves meanwhile.

Where more than one image of a place is allowed, as many are taken as the camera's noise asks for: air before
it shifts fibres by micrometres, another way in every image, and no camera tells that of one image.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import Operation
from fiberloom.metrology import Camera, Measurement, SeveralImages
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.sources.errors import CameraAborted, CameraError, CameraGone
from fiberloom.typing import Floats

ALARM, BACK = "alarm", "camera"
"""Kinds of events: no image came; images come again."""

CALM = 0.2
"""Of the requirement: noise of a place, 2-D rms, below which no further image of it is taken."""


def know_fiducials(camera: Camera, plane: FocalPlane) -> None:
    """Tells a `camera` that goes by fiducials where those of the `plane` are, as a calibration found them."""
    if (know := getattr(camera, "know_fiducials", None)) is not None:
        know(plane.fiducials[:, :2])


class PatientCamera:
    """The camera of one field. The deadline of each exposure is the source's, and so are its own retries."""

    def __init__(
        self,
        camera: Camera,
        operation: Operation,
        event: Callable[[str, str], None],
        sleep: Callable[[float], Awaitable[None]],
    ) -> None:
        """`camera`: of the field; `operation`: `camera_retries` and `camera_wait_s`; `event`: records kind
        and text; `sleep`: lets seconds pass, still listening to the bus."""
        self._camera, self._event, self._sleep = camera, event, sleep
        self.retries, self.wait_s = operation.camera_retries, operation.camera_wait_s
        self._enough_um, self._noise_um = CALM * operation.requirement_um, float("nan")
        self._taken: list[Measurement] = []

    async def once(self, expected_mm: Floats | None) -> Measurement:
        """An image, taken and reduced beside the event loop. `expected_mm` (N, 2): of the fibres.

        Raises CameraError where none comes, AcquisitionError where it shows no fiducials.
        """
        try:
            return await asyncio.to_thread(self._camera.measure, expected_mm)
        except asyncio.CancelledError:
            # no longer wanted; its thread would keep the process until the deadline
            if (abort := getattr(self._camera, "abort", None)) is not None:
                abort()
            raise

    async def again(self, expected_mm: Floats, image: Measurement) -> Measurement | None:
        """The spots of an `image`, matched to where fibres are expected by now, (N, 2) mm: no arm has moved.

        None: it is not the camera's last one, or the camera cannot look at an image again.
        """
        rematch = getattr(self._camera, "rematch", None)
        return None if rematch is None else await asyncio.to_thread(rematch, expected_mm, image)

    async def patiently(self, expected_mm: Floats | None) -> Measurement:
        """As `once`, and again after a wait where none comes; each failure is an alarm.

        `expected_mm` (N, 2). Raises CameraGone after the last try.
        """
        for failed in range(self.retries + 1):
            try:
                image = await self.once(expected_mm)
            except CameraAborted:
                raise
            except (CameraError, AcquisitionError) as error:
                await self._alarm(error, failed)
                continue
            if failed:
                self._event(BACK, f"images again, after {failed} that could not be used")
            return image
        raise AssertionError("the last failure is raised")

    async def several(self, expected_mm: Floats | None, most: int) -> Measurement:
        """The mean of `most` images or fewer: as many as make its noise small against the requirement.

        `expected_mm` (N, 2). The first one as `patiently`; where a further one does not come, those that came
        are used. How noisy images are, those of the last place have told; of the first place two are taken.
        """
        self._taken = taken = []
        taken.append(await self.patiently(expected_mm))
        while len(taken) < self._wanted(most):
            try:
                taken.append(await self.once(expected_mm))
            except CameraAborted:
                raise
            except (CameraError, AcquisitionError) as error:
                self._event(ALARM, f"no image: {error}; goes on with {len(taken)} of this place")
                break
            if np.isfinite(noise_um := SeveralImages(taken).noise_um()):
                self._noise_um = noise_um
        return SeveralImages(taken).mean()

    def before_the_end(self) -> Measurement | None:
        """Of the last place, by the images that came before `several` was ended; None: there was none."""
        return SeveralImages(self._taken).mean() if self._taken else None

    def _wanted(self, most: int) -> int:
        """Images of one place."""
        if np.isnan(self._noise_um):
            return min(most, 2)
        return int(np.clip(np.ceil((self._noise_um / self._enough_um) ** 2), 1, most))

    async def _alarm(self, error: Exception, failed: int) -> None:
        """Records a failure and waits; after the last one raises CameraGone."""
        left = self.retries - failed
        then = f"once more in {self.wait_s:g} s ({left} left)" if left else "the command ends"
        self._event(ALARM, f"no image: {error}; nothing moves; {then}")
        if not left:
            raise CameraGone(
                f"{error}; that was image {failed + 1} in a row that could not be used, so the command ends: "
                "look at the camera (`fiberloom doctor`), then begin again"
            ) from error
        await self._sleep(self.wait_s)
