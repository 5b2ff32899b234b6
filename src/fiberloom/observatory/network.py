"""Where an interface listens, and what it needs to be installed."""

from __future__ import annotations

import importlib.util
import ipaddress
import socket
from dataclasses import dataclass

from fiberloom.errors import InputError
from fiberloom.files import tcp_port


@dataclass(frozen=True)
class Endpoint:
    """An address to listen at; beyond loopback only where a person has said so."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str, default_port: int, trusted_network: bool = False) -> Endpoint:
        """From `HOST[:PORT]`, an IPv4 address or `localhost`.

        `trusted_network`: any program there may move the array. Without it: InputError beyond loopback.
        """
        host, _, port = text.partition(":")
        host = "127.0.0.1" if host == "localhost" else host
        if port and tcp_port(port) is None:
            raise InputError(f"'{text}': expected HOST[:PORT], e.g. 127.0.0.1:{default_port}")
        try:
            address = ipaddress.IPv4Address(host)
        except ValueError:
            raise InputError(f"'{text}': an IPv4 address is needed, e.g. 127.0.0.1:{default_port}") from None
        if not (address.is_loopback or trusted_network):
            raise InputError(
                f"'{text}': any program there could move the array; keep to 127.0.0.1, or say that the "
                "network is a trusted one"
            )
        return cls(host, int(port) if port else default_port)

    def require_free(self) -> None:
        """InputError where another program listens there, or the host has no such address."""
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server itself will
            try:
                probe.bind((self.host, self.port))
            except OSError as error:
                raise InputError(f"{self}: {error.strerror}; choose another port") from None

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def need(package: str, extra: str) -> None:
    """InputError, which says what to install, where the `package` of an `extra` is missing."""
    if importlib.util.find_spec(package) is None:
        raise InputError(f"{package} is not installed: pip install 'fiberloom[{extra}]'")
