"""Alpaca discovery: the served camera is found by `alpyca`, by our client, and by nothing else."""

import json
import socket

import pytest

from fiberloom.metrology.sources import alpaca
from fiberloom.metrology.sources.alpaca import AlpacaSource, alpaca_servers
from fiberloom.metrology.sources.errors import CameraSilent
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.discovery import DiscoveryAnswer

SERVED = Address("127.0.0.1", 11119)


@pytest.fixture
def answer(monkeypatch):
    """On a port of its own, which clients are told."""
    made = DiscoveryAnswer(SERVED, 0)
    monkeypatch.setattr(alpaca, "DISCOVERY_PORT", made.port)
    yield made
    made.close()


def test_alpyca_finds_it(answer, monkeypatch):
    discovery = pytest.importorskip("alpaca.discovery", reason="pip install alpyca: the independent client")
    monkeypatch.setattr(discovery, "port", answer.port)
    assert f"127.0.0.1:{SERVED.port}" in discovery.search_ipv4(numquery=1, timeout=1)


def test_our_client_finds_it(answer):
    assert f"127.0.0.1:{SERVED.port}" in alpaca_servers()


def test_a_wrong_address_is_told_where_servers_are(answer):
    source = AlpacaSource("127.0.0.1", 1, 0, ExposureSettings(retries=0))
    with pytest.raises(
        CameraSilent, match=r"is this its address[?] Alpaca servers .*alpaca://127.0.0.1:11119"
    ):
        source.expose()


def test_none_is_found_where_none_answers(answer):
    answer.close()
    source = AlpacaSource("127.0.0.1", 1, 0, ExposureSettings(retries=0))
    with pytest.raises(CameraSilent, match=r"is this its address[?]$"):
        source.expose()


def test_two_servers_share_the_port(answer):
    with_another = DiscoveryAnswer(Address("127.0.0.1", 11120), answer.port)
    try:
        assert {"127.0.0.1:11119", "127.0.0.1:11120"} <= set(alpaca_servers())
    finally:
        with_another.close()


@pytest.mark.parametrize("said", [b"", b"alpacadiscovery", b"hello", bytes(1000)])
def test_other_questions_are_not_answered(answer, said):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.sendto(said, ("127.0.0.1", answer.port))
        asking.sendto(alpaca.DISCOVERY_QUESTION, ("127.0.0.1", answer.port))
        asking.settimeout(60.0)
        assert json.loads(asking.recv(1024)) == {"AlpacaPort": SERVED.port}
        asking.settimeout(0.2)
        with pytest.raises(TimeoutError):
            asking.recv(1024)


@pytest.mark.parametrize(
    ("served", "asks", "answers"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("localhost", "127.0.0.3", True),
        ("127.0.0.1", "192.168.1.7", False),
        ("192.168.1.5", "192.168.1.7", True),
        ("0.0.0.0", "192.168.1.7", True),
    ],
)
def test_a_camera_of_this_machine_alone_answers_this_machine_alone(served, asks, answers):
    made = DiscoveryAnswer(Address(served, 11119), 0)
    assert made._is_meant(asks) is answers
    made.close()


@pytest.mark.parametrize("said", [b"", b"[]", b"{}", b'{"AlpacaPort": "x"}', b"\xff", b"7"])
def test_answers_that_are_none_are_passed_over(monkeypatch, said):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("", 0))
        monkeypatch.setattr(alpaca, "DISCOVERY_PORT", server.getsockname()[1])
        monkeypatch.setattr(alpaca, "_DISCOVERY_S", 0.2)
        send, asked = socket.socket.sendto, []

        def sendto(self, data, place):
            sent = send(self, data, place)
            asked.append(self)
            send(server, said, ("127.0.0.1", self.getsockname()[1]))
            return sent

        monkeypatch.setattr(socket.socket, "sendto", sendto)
        assert alpaca_servers() == []
        assert asked
