"""A field that is opened by the address of its gateway: frames over TCP, in real time."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.store import Store
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.server.server import Address, ServerSettings, TwinServer

N, SPEED = 7, 10.0


class Outside:
    """A camera that looks at the array from outside of its clock."""

    def __init__(self, server, twin):
        self.server, self.camera = server, NoiseCamera(twin, 0.669, 0)

    def measure(self, expected_mm=None):
        with self.server.real.held():
            return self.camera.measure(expected_mm)


@pytest.mark.slow
def test_two_observations_through_a_gateway(desk):
    plane = fl.FocalPlane.of("sdssv", n=N)
    fl.Field.twin(plane).run.calibrate().save("maps.npz")
    array = Twin(plane, draw_units(plane, 0), seed=0, threads=1)

    async def night():
        server = TwinServer(array, [Address("127.0.0.1", 0)], settings=ServerSettings(speed=SPEED))
        await server.open()
        try:
            bus = f"cannet://{server.listeners[0].address}"
            field = fl.Field.open(plane, bus, camera=Outside(server, array), calibration="maps.npz")
            targets = fl.read_targets("targets.csv")
            # the connection is made anew for each: a gateway takes one client at a time
            return [await field.observe(targets, corrections=1, out="night") for _ in range(2)]
        finally:
            server.close()

    seen = asyncio.run(asyncio.wait_for(night(), 300.0))
    for one in seen:
        assert one.summary()["n_assigned"] == N
        assert one.summary()["collisions_verified"] == 0
        # as measured, one image of 0.67 um after a correction by one
        assert np.nanmax(one.moves[-1].measured_error_um) < 5.0
    with Store.open("night/store.sqlite") as store:
        assert [run.status for run in store.runs()] == ["finished", "finished"]
