"""The settings files that the runbook shows under Security fit together and are complete."""

import re
from pathlib import Path

import pytest

from service.cli.main import main
from service.security.listening import has_rules, need_locked_bus, need_locked_pages
from service.settings.config import Settings, load_settings
from service.worker_pools import accepted_by
from workers.worker.acceptance import refusal
from workers.worker.config import WorkerConfig

RUNBOOK = (Path(__file__).parents[3] / "deploy" / "README.md").read_text(encoding="utf-8")

(SHOWN,) = re.findall(r"```\n(# router\.toml\n.*?)```", RUNBOOK, re.DOTALL)


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Settings]:
    """Every file as the runbook shows it, in a folder with the files that the commands make."""
    monkeypatch.chdir(tmp_path)
    names = ["--router=router", "--service=service", "--worker=miner-a", "--operator=anna"]
    assert main(["certs", ".", *names]) == 0
    assert main(["acl", ".", "--out", "rules.json"]) == 0
    assert main(["token", "tokens", "--name", "anna", "--role", "operator"]) == 0
    found = {}
    for content in SHOWN.split("\n\n"):
        file = Path(content.split()[1].rstrip(":;"))
        file.write_text(content)
        found[file.stem] = load_settings(config=file)
    return found


def test_every_file_is_locked_and_names_files_that_the_commands_made(
    shown: dict[str, Settings],
) -> None:
    assert list(shown) == ["router", "service", "miner-a", "review"]
    for each in shown.values():
        listens = each.listen.split(",") if each.listen else []
        connects = each.connect.split(",") if each.connect else []
        need_locked_bus(each, listens=listens, connects=connects)
        for name in ("http_listen", "worker_http_listen", "review_listen"):
            need_locked_pages(each, getattr(each, name), setting=name)
        written = (each.tls_ca, each.tls_certificate, each.tls_key, each.http_tokens)
        assert [path for path in written if path and not Path(path).exists()] == []
    assert has_rules(shown["router"])


def test_the_worker_accepts_the_work_of_the_service(shown: dict[str, Settings]) -> None:
    service, worker = shown["service"], shown["miner-a"]
    config = WorkerConfig("miner-a", (worker.connect,), accepts=accepted_by(worker))
    assert service.bucket
    assert refusal(service.mining(), config) == ""
