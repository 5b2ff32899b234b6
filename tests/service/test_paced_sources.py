"""A twin at the pace of an array calibrates motors before a field where the one inside does, and else not."""

from types import SimpleNamespace

import pytest

import fiberloom as fl
from fiberloom.blocking import finish
from fiberloom.connect import open_hardware
from fiberloom.operation.known import Known
from fiberloom.service.pace import paced


@pytest.mark.parametrize(("instrument", "said"), [("sdssv", []), ("pfs", ["calibrating motors"])])
def test_motors_are_said_to_be_calibrated_only_where_they_are(instrument, said):
    plane, told = fl.FocalPlane.of(instrument, seed=0, n=5), []
    source = open_hardware(plane, "twin:", "noise")
    known = SimpleNamespace(plane=plane, doubtful={}, scatter=None)
    finish(Known.leave_out(known, paced(source, 1000.0), told.append))
    assert told == said
