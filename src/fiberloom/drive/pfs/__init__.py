"""The electronics of PFS: the FPGA's protocol, a client of it, and the drive of the cobras behind it."""

from fiberloom.drive.pfs.client import FpgaClient
from fiberloom.drive.pfs.drive import CobraDrive, CobraSettings

__all__ = ["CobraDrive", "CobraSettings", "FpgaClient"]
