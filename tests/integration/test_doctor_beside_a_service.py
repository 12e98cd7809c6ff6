"""The doctor beside a running service of its own version, and of another one."""

from importlib.metadata import version
from pathlib import Path

import pytest

from service.doctor import network as doctor_network
from service.settings.config import load_settings
from tests.integration.daemons import System
from tests.integration.running import two_logs

pytestmark = pytest.mark.integration

OURS = version("counterpoint")


def findings(endpoint: str) -> list[tuple[str, str]]:
    settings = load_settings(connect=endpoint, http_listen="", worker_http_listen="")
    return [(found.verdict, found.says) for found in doctor_network.router(settings)]


def test_a_service_of_the_same_version_is_as_it_should_be(tmp_path: Path) -> None:
    with two_logs(tmp_path) as parts:
        assert findings(parts.endpoint)[1:] == [
            ("ok", f"answers under 'counterpoint', of version {OURS}"),
            ("warning", "has 0 workers, so nothing is mined"),
        ]


def test_a_service_of_another_version_is_a_warning_that_names_both(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    metadata = tmp_path / "other" / "counterpoint-99.1.dist-info" / "METADATA"
    metadata.parent.mkdir(parents=True)
    metadata.write_text("Metadata-Version: 2.1\nName: counterpoint\nVersion: 99.1\n")
    root = Path(__file__).resolve().parents[2]
    # Not the working folder first: an editable installation has its metadata there.
    other = {"PYTHONPATH": f"{metadata.parents[1]}:{root}", "PYTHONSAFEPATH": "1"}
    system = System(tmp_path, str(tmp_path / "logs"), env=other)
    try:
        system.router.start()
        system.service.start()
        system.until(lambda: "serving" in system.service.said(), "the service is up")
        verdict, says = findings(system.endpoint)[1]
        assert verdict == "warning"
        assert f"is of version 99.1 and this command of version {OURS}" in says
        metadata.write_text(metadata.read_text().replace("99.1", OURS))
        assert "99.1" in findings(system.endpoint)[1][1], (
            "it is what was started, not what lies there now"
        )
    finally:
        system.end()
