"""Routers that are all given the same list pass over themselves in it."""

import pytest

from schemas.transport.endpoints import is_own

LISTEN = ["tcp/0.0.0.0:7447"]


@pytest.mark.parametrize(
    ("endpoint", "own"),
    [
        ("tcp/fleet-router-0.fleet-router:7447", True),
        ("tcp/fleet-router-0:7447", True),
        ("tcp/fleet-router-0.fleet-router:7448", False),
        ("tcp/fleet-router-1.fleet-router:7447", False),
        ("tls/fleet-router-0:7447#enable_mtls=true", True),
        ("tcp/0.0.0.0:7447", True),
        ("tcp/127.0.0.1:7447", False),
    ],
)
def test_a_router_knows_its_own_endpoint_by_name_and_port(endpoint: str, own: bool) -> None:
    assert is_own(endpoint, LISTEN, machine="fleet-router-0.local") is own
