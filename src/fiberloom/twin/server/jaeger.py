"""The configuration with which jaeger, SDSS-V's own software, drives a served twin."""

from __future__ import annotations

import json
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.device import PORTS


def jaeger_config(addresses: list[Address], folder: Path) -> str:
    """What jaeger needs to know to drive this twin: its JAEGER_<OBSERVATORY>_CONFIG_PATH.

    Logs, trajectories and snapshots go to `folder`.
    """
    if len({a.port for a in addresses}) > 1:
        raise InputError(
            "--jaeger-config: jaeger has one port for all devices; listen at a loopback address, where "
            "devices get 127.0.0.1, 127.0.0.2, ..."
        )
    profile = {
        "interface": "cannet",
        "channels": [a.host for a in addresses],
        "port": addresses[0].port,
        "buses": list(PORTS),
        "bitrate": 1_000_000,
        "timeout": 1,
        "status_interval": 5,
    }
    paths = {"snapshot_path": str(folder), "configuration_snapshot_path": str(folder)}
    config = {
        "profiles": {"default": "twin", "twin": profile},
        "fps": {"use_lock": False, "skip_assignments_check": True, **paths},
        "positioner": {"trajectory_dump_path": str(folder)},
        "files": {"log_dir": str(folder)},
    }
    return json.dumps(config, indent=2) + "\n"  # which is YAML, too
