"""Which pages may open a socket to the server of `rainsim view`."""

import pytest

pytest.importorskip("viser")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from rainsim.view.page import _server

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address():
    server = _server(0, None)
    yield f"ws://127.0.0.1:{server.get_port()}"
    server.stop()


@pytest.mark.parametrize("origin", ["http://127.0.0.1:8080", "http://localhost:8081", None])
def test_its_own_pages_are_served(address, origin):
    with connect(address, origin=origin) as socket:
        assert socket.response.status_code == 101


@pytest.mark.parametrize(
    "origin", ["http://rain.example", "https://localhost.rain.example", "null", "file://"]
)
def test_pages_of_other_sites_are_refused(address, origin):
    with pytest.raises(InvalidStatus) as refused:
        connect(address, origin=origin)
    assert refused.value.response.status_code == 403


def test_other_servers_are_left_alone(address):
    from websockets.asyncio import server

    assert server.serve.__module__.startswith("websockets")
