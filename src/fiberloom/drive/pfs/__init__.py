"""The electronics of PFS: the FPGA's protocol, and a client of it."""
