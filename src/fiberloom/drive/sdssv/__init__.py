"""SDSS-V: closed-loop motors that follow trajectories and report where they are."""

from fiberloom.drive.sdssv.care import MotorCare
from fiberloom.drive.sdssv.drive import SdssvDrive, on_the_wire

__all__ = ["MotorCare", "SdssvDrive", "on_the_wire"]
