"""Looking while arms are out: no image is an alarm, and another one is asked for; nothing moves meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from fiberloom.instruments.model import Operation
from fiberloom.metrology import Camera, Measurement
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.sources.errors import CameraAborted, CameraError, CameraGone
from fiberloom.typing import Floats

ALARM, BACK = "alarm", "camera"
"""Kinds of events: no image came; images come again."""


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
