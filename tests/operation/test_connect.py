"""Hardware by its address, and the one name that an array has in the store."""

import subprocess
import sys

import pytest

from fiberloom.connect import array_address, is_shared, open_hardware
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.source import OpenedArray

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("cannet://10.1.10.31", "cannet://10.1.10.31:19228"),
        ("cannet://b:1,a:2", "cannet:a:2,B:1"),
        ("socketcan://can0", "socketcan:can0"),
        ("socketcan:can1,can0", "socketcan:can0,can1"),
        ("gateways://Moons", "gateways://moons:4700"),
        ("radio://lamost", "radio://LAMOST:4900"),
        ("fpga://pfs", "fpga://pfs:4001"),
    ],
)
def test_one_array_has_one_name(one, other):
    assert array_address(one) == array_address(other)


def test_a_twin_in_a_process_is_no_other_ones():
    assert array_address("twin:") == array_address("twin:image")
    code = "from fiberloom.connect import array_address; print(array_address('twin:'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() != array_address("twin:")


def test_which_buses_take_a_second_talker():
    assert is_shared("socketcan:can0")
    assert not any(map(is_shared, ("cannet://a", "slcan:/dev/ttyUSB0", "twin:")))


def test_addresses_open_what_they_name():
    assert isinstance(open_hardware(PLANE, "cannet://a", "alpaca://b:11111/0"), OpenedArray)
    twin = open_hardware(PLANE, "twin:", "twin:noise", seed=3)
    assert (type(twin).__name__, twin.camera, twin.seed) == ("TwinSource", "noise", 3)
    assert open_hardware(PLANE, "twin:", "twin:").camera == "image"


@pytest.mark.parametrize(
    ("bus", "camera", "said"),
    [
        ("cannet://a", "twin:image", "camera of the twin inside"),
        ("cannet://a", "film", "alpaca://HOST:PORT/NUMBER"),
        ("nothing", "alpaca://b:11111/0", "expected cannet://"),
        ("twin:", "film", "known are noise, image"),
    ],
)
def test_what_does_not_fit_is_told(bus, camera, said):
    with pytest.raises(InputError, match=said):
        open_hardware(PLANE, bus, camera)


def test_faults_need_a_twin():
    with pytest.raises(InputError, match="--faults goes with the twin"):
        open_hardware(PLANE, "cannet://a", "alpaca://b:11111/0", faults="dark=1")


def test_a_real_array_loads_no_line_of_the_twin():
    code = (
        "import sys, fiberloom as fl\n"
        "from fiberloom.connect import open_hardware\n"
        "fl.Field.open(fl.FocalPlane.of('sdssv', n=7), 'cannet://a', 'alpaca://b:11111/0')\n"
        "print([m for m in sys.modules if m.startswith('fiberloom.twin')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
