"""Ports of addresses: digits that are none of ours, and hosts that can be none, are refused in words."""

import asyncio

import pytest

from fiberloom.bus.cannet import CanNetTransport
from fiberloom.drive.lamost import radio_address
from fiberloom.drive.moons.tcp import gateway_address
from fiberloom.drive.pfs.client import FpgaClient
from fiberloom.drive.pfs.streams import over_tcp, tcp_address
from fiberloom.errors import InputError
from fiberloom.files import tcp_port
from fiberloom.metrology.sources.spec import CameraSpec
from fiberloom.twin.server.address import address_of

WRONG = ["\u00b2", "1\u00b2", "\u0663", "0", "65536", "123456", "-1", "+1", " 1", "1_0", "a"]
NO_HOST = ["a" * 64, "a..b", ".a"]
"""Names that the rules of names exclude."""


def can_net(host):
    asyncio.run(CanNetTransport.open([host]))


def camera(address):
    return CameraSpec.parse(f"alpaca://{address}/0").host


@pytest.mark.parametrize("text", WRONG)
def test_a_port_that_is_none(text):
    assert tcp_port(text) is None


def test_a_port():
    assert [tcp_port(text) for text in ("1", "04700", "65535")] == [1, 4700, 65535]
    assert tcp_port("11", last=10) is None


@pytest.mark.parametrize("text", WRONG[:6])
@pytest.mark.parametrize("read", [can_net, tcp_address, radio_address, gateway_address, address_of, camera])
def test_an_address_with_it(read, text):
    with pytest.raises(InputError, match="port"):
        read(f"127.0.0.1:{text}")


@pytest.mark.parametrize("host", NO_HOST)
def test_a_host_that_can_be_none(host):
    with pytest.raises(InputError, match=f"CAN@net gateway {host}:19228: no connection"):
        can_net(host)
    with pytest.raises(InputError, match=f"FPGA {host}:4001: no connection"):
        asyncio.run(FpgaClient(over_tcp(host, 4001), tries=1).open())
