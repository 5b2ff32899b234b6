"""Where a served twin listens, and who can reach it."""

import pytest

from fiberloom.cli.twin import TwinOptions, _warn_of_the_network
from fiberloom.errors import InputError
from fiberloom.twin.server.address import Address, addresses_of, reachable_from_outside


def test_loopback_counts_up_and_other_hosts_have_ports_in_a_row():
    assert addresses_of("127.0.0.1:1000", 2) == [Address("127.0.0.1", 1000), Address("127.0.0.2", 1000)]
    assert addresses_of("10.0.0.5:1000", 2) == [Address("10.0.0.5", 1000), Address("10.0.0.5", 1001)]
    with pytest.raises(InputError, match="need the ports up to 65536"):
        addresses_of("10.0.0.5:65535", 2)


@pytest.mark.parametrize(
    ("host", "outside"),
    [("127.0.0.1", False), ("127.3.2.1", False), ("localhost", False), ("0.0.0.0", True), ("obs1", True)],
)
def test_who_can_reach_it(host, outside):
    assert bool(reachable_from_outside([Address(host, 1)])) == outside


@pytest.mark.parametrize("camera", [None, "0.0.0.0:11111"])
def test_a_twin_that_others_can_reach_says_so(camera, capsys):
    _warn_of_the_network(TwinOptions(camera_listen=camera), [Address("127.0.0.1", 19228)])
    assert ("without a password" in capsys.readouterr().err) == (camera is not None)
