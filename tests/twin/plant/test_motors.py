"""What the twin has no motors for is refused in words, and what needs none works."""

import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import bench_hardware, draw_units, field_hardware


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("desi", "alpha is a bldc motor in open loop with a gear of 337.36"),
        ("pfs", "alpha is a piezo motor in open loop"),
        ("lamost", "alpha is a stepper motor in open loop"),
        ("megara", "has no metrology camera"),
        ("moons", "has no metrology camera"),
    ],
)
def test_other_motors_are_refused(name, words):
    plane = generate(load_instrument(name), 0, 3)
    units = draw_units(plane, 0)
    for make in (field_hardware, bench_hardware):
        with pytest.raises(InputError, match=words):
            make(plane, units, 0)
