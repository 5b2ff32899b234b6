"""The twin's camera as an INDI driver behind a server of its own, with `indipydriver` and `indipyserver`."""

from __future__ import annotations

import asyncio
import importlib
import socket
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from fiberloom.blocking import finish
from fiberloom.metrology.images import CameraImage, write_image
from fiberloom.metrology.sources.indi_child import BLOB
from fiberloom.metrology.sources.spec import require
from fiberloom.twin.faults.kinds import CameraFaultKind
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import TwinShutter

NAME = "Fiberloom Twin"
_HOW = "pip install 'fiberloom[cameras]'"
_GROUP = "Main Control"
_LISTENS_S = 20.0
"""So long the server may take to listen; a tenth of a second where the machine has nothing else to do."""
_POLL_S = 0.02


def check_packages() -> None:
    """Refuses where a package is missing."""
    for package in ("indipydriver", "indipyserver"):
        require(package, _HOW, "INDI")


class IndiServer:
    """Serves a shutter at an address, in a thread, until the process ends; listens once it is made.

    OSError where the address is in use, or nothing listens there after `_LISTENS_S`.
    """

    def __init__(self, shutter: TwinShutter, address: Address) -> None:
        check_packages()
        # the server itself says nothing of an address in use
        with socket.create_server((address.host, address.port)):
            pass
        self._shutter, self._address = shutter, address
        threading.Thread(target=lambda: finish(self._serve()), daemon=True).start()
        self._wait_listening()

    def _wait_listening(self) -> None:
        """A host that reads the greeting may connect at once."""
        end_s = time.monotonic() + _LISTENS_S
        while True:
            try:
                socket.create_connection((self._address.host, self._address.port), _LISTENS_S).close()
                return
            except OSError:
                if time.monotonic() > end_s:
                    raise
                time.sleep(_POLL_S)

    async def _serve(self) -> None:
        driver = _driver(self._shutter)
        server = importlib.import_module("indipyserver").IPyServer(
            driver, host=self._address.host, port=self._address.port
        )
        await server.asyncrun()


def _driver(shutter: TwinShutter) -> Any:
    """The driver: what clients set arrives in `rxevent`."""
    indi = importlib.import_module("indipydriver")
    exposing: set[asyncio.Task[None]] = set()

    class CameraDriver(indi.IPyDriver):  # type: ignore[misc, name-defined]  # of a package without types
        """Exposes when told."""

        async def rxevent(self, event: Any) -> None:
            """What a client sets."""
            name, vector = event.vectorname, event.vector
            if name == "CONNECTION":
                for member in event:
                    vector[member] = event[member]
                await vector.send_setVector(state="Ok")
            elif name == "CCD_ABORT_EXPOSURE":
                shutter.give_up()
                await vector.send_setVector(state="Ok")
            elif name == "CCD_EXPOSURE":
                seconds = indi.getfloat(event["CCD_EXPOSURE_VALUE"])
                await vector.send_setVector(state="Busy")
                task = asyncio.create_task(_expose(self[NAME], shutter, seconds))
                exposing.add(task)
                task.add_done_callback(exposing.discard)

    return CameraDriver(_device(indi, shutter))


async def _expose(device: Any, shutter: TwinShutter, seconds: float) -> None:
    image = await asyncio.to_thread(shutter.take, seconds)
    faults = shutter.faults()
    exposure = device["CCD_EXPOSURE"]
    if image is None:
        if CameraFaultKind.ERROR in faults:
            await device.send_device_message("the camera is broken")
            await exposure.send_setVector(state="Alert")
        return
    data = await asyncio.to_thread(_fits, image)
    if CameraFaultKind.HALF in faults:
        data = data[: len(data) // 2]
    await exposure.send_setVector(state="Ok")
    device[BLOB][BLOB] = data
    await device[BLOB].send_setVectorMembers(state="Ok", members=[BLOB])


def _fits(image: CameraImage) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.fits"
        write_image(image, path)
        return path.read_bytes()


def _device(indi: Any, shutter: TwinShutter) -> Any:
    """What clients are told that the camera has."""
    geometry = shutter.camera.model.optics.geometry
    about = {"CCD_MAX_X": geometry.width_px, "CCD_MAX_Y": geometry.height_px, "CCD_BITSPERPIXEL": 16}
    numbers = [indi.NumberMember(key, key, format="%.0f", membervalue=value) for key, value in about.items()]
    seconds = indi.NumberMember(
        "CCD_EXPOSURE_VALUE", "Seconds", format="%.4f", min=0, max=3600, step=0, membervalue=1
    )
    connection = [
        indi.SwitchMember("CONNECT", "Connect", "Off"),
        indi.SwitchMember("DISCONNECT", "Disconnect", "On"),
    ]
    abort = [indi.SwitchMember("ABORT", "Abort", "Off")]
    blob = indi.BLOBMember(BLOB, "Image", blobformat=".fits")
    return indi.Device(
        NAME,
        [
            indi.SwitchVector("CONNECTION", "Connection", _GROUP, "rw", "OneOfMany", "Idle", connection),
            indi.NumberVector("CCD_EXPOSURE", "Exposure", _GROUP, "rw", "Idle", [seconds]),
            indi.SwitchVector("CCD_ABORT_EXPOSURE", "Abort", _GROUP, "wo", "AtMostOne", "Idle", abort),
            indi.NumberVector("CCD_INFO", "Chip", _GROUP, "ro", "Idle", numbers),
            indi.BLOBVector(BLOB, "Image", _GROUP, "ro", "Idle", [blob]),
        ],
    )
