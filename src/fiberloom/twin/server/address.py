"""Where the devices of a served twin listen."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass

from fiberloom.errors import InputError
from fiberloom.files import tcp_port


@dataclass(frozen=True)
class Address:
    """Where a device listens."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def reachable_from_outside(addresses: Iterable[Address]) -> list[Address]:
    """Those of `addresses` that other machines may reach: all but loopback, and every name but localhost."""
    return [address for address in addresses if not _is_loopback(address.host)]


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def address_of(text: str, option: str = "--listen") -> Address:
    """HOST:PORT of an option."""
    host, _, told = text.rpartition(":")
    if not host or (port := tcp_port(told)) is None:
        raise InputError(f"{option} {text}: write HOST:PORT with a port 1 to 65535")
    return Address(host, port)


def addresses_of(text: str, devices: int) -> list[Address]:
    """Where the devices listen: HOST:PORT, and what follows it.

    jaeger has one port number for all of its devices, so loopback addresses are counted up and the port
    stays (127.0.0.1, 127.0.0.2, ...); with any other host ports are counted up.
    """
    base = address_of(text)
    host, port = base.host, base.port
    try:
        first = ipaddress.IPv4Address(host)
    except ValueError:
        first = None
    if first is not None and first.is_loopback:
        return [Address(str(first + k), port) for k in range(devices)]
    if port + devices > 65536:
        raise InputError(f"--listen {text}: {devices} devices need the ports up to {port + devices - 1}")
    return [Address(host, port + k) for k in range(devices)]
