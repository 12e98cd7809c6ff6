"""The doctor with certificates of several roles: it claims nothing that one may not see."""

from collections.abc import Iterator
from importlib.metadata import version

import pytest

from schemas.transport import keys
from service.doctor import network as doctor_network
from service.settings.config import load_settings
from tests.integration.locked_bus import ROOT, LockedBus, locked_bus

pytestmark = pytest.mark.integration

ANSWERS = ("ok", f"answers under 'counterpoint', of version {version('counterpoint')}")


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LockedBus]:
    with locked_bus(tmp_path_factory.mktemp("doctor")) as parts:
        yield parts


def findings(bus: LockedBus, name: str) -> list[tuple[str, str]]:
    locks = bus.locks(name)
    settings = load_settings(
        connect=bus.endpoint,
        tls_ca=locks.ca,
        tls_certificate=locks.certificate,
        tls_key=locks.key,
    )
    return [(str(found.verdict), found.says) for found in doctor_network.router(settings)][1:]


def test_a_worker_that_may_not_see_the_workers_does_not_say_that_there_are_none(
    bus: LockedBus,
) -> None:
    answers, (verdict, says) = findings(bus, "miner-a")
    assert answers == ANSWERS
    assert verdict == "ok"
    assert says.startswith("the certificate of miner-a may not see its workers: ")


@pytest.mark.parametrize("name", ["operator", "reader", "service"])
def test_who_may_see_the_workers_counts_them(bus: LockedBus, name: str) -> None:
    none = ("warning", "has 0 workers, so nothing is mined")
    assert findings(bus, name) == [ANSWERS, none]
    alive = keys.live(root=ROOT, role="worker", ident=f"miner-b{keys.OWNER_END}1")
    with bus.session("miner-b") as miner, miner.liveliness().declare_token(alive):
        assert findings(bus, name) == [ANSWERS, ("ok", "has 1 workers")]


def test_a_certificate_that_no_rule_names_is_told_so(bus: LockedBus) -> None:
    ((verdict, says),) = findings(bus, "gone")
    assert verdict == "warning"
    assert says.startswith("none answers under 'counterpoint': start `counterpoint service`, or ")
    assert "else no rule of the router names this certificate, gone, as after its revoc" in says
