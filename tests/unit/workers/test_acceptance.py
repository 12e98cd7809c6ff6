"""What a worker accepts of a service: all on this machine, elsewhere what its own settings name."""

from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.endpoints import is_loopback
from workers.worker.acceptance import is_inside, refusal
from workers.worker.config import Accepted, WorkerConfig

ELSEWHERE = "tcp/router:7447"
OURS = Accepted(bucket="s3://fleet", artifacts="s3://overlays/fleet", model="/models")


def asked(**other: str) -> MiningSettings:
    return MiningSettings.model_validate(
        {"bucket": "s3://fleet", "artifacts": "s3://overlays/fleet", "supervised": "recorded"}
        | other
    )


def worker(*connect: str, accepts: Accepted = OURS) -> WorkerConfig:
    return WorkerConfig("w1", connect, accepts=accepts)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/127.8.9.10:7447",
        "tls/localhost:7447",
        "tcp/[::1]:7447",
        "tcp/127.0.0.1:7447?prio=1#iface=lo",
        "unixsock-stream//run/counterpoint.sock",
    ],
)
def test_a_router_on_the_loopback_is_known(endpoint: str) -> None:
    assert is_loopback(endpoint)


@pytest.mark.parametrize(
    "endpoint",
    [
        ELSEWHERE,
        "tcp/192.0.2.7:7447",
        "tcp/0.0.0.0:7447",
        "tcp/[::]:7447",
        "tcp/[2001:db8::1]:7447",
        "tcp/127.0.0.1.example.com:7447",
        "tcp/localhost.example.com:7447",
    ],
)
def test_any_other_router_is_not(endpoint: str) -> None:
    assert not is_loopback(endpoint)


def test_on_the_loopback_everything_is_accepted() -> None:
    config = worker("tcp/127.0.0.1:7447", "tcp/localhost:7448", accepts=Accepted())
    assert refusal(asked(model="/any/adapter.toml", weights="/any"), config) == ""


def test_one_router_elsewhere_is_enough_to_be_careful() -> None:
    config = worker("tcp/127.0.0.1:7447", ELSEWHERE, accepts=Accepted())
    assert "the worker's own setting bucket is empty" in refusal(asked(), config)


def test_what_its_own_settings_name_or_hold_is_accepted() -> None:
    assert refusal(asked(), worker(ELSEWHERE)) == ""
    deeper = asked(artifacts="s3://overlays/fleet/2026", model="/models/seven/adapter.toml")
    assert refusal(deeper, worker(ELSEWHERE)) == ""


@pytest.mark.parametrize(
    ("setting", "named", "own"),
    [
        ("bucket", "s3://other", "bucket = 's3://fleet'"),
        ("bucket", "file:///etc", "bucket = 's3://fleet'"),
        ("artifacts", "s3://overlays/fleet-2", "artifacts = 's3://overlays/fleet'"),
        ("artifacts", "s3://overlays/fleet/../cars", "artifacts = 's3://overlays/fleet'"),
        ("artifacts", "s3://overlays/fleet/%2e%2e/cars", "artifacts = 's3://overlays/fleet'"),
        ("artifacts", "s3://overlays/fleet?endpoint=evil", "artifacts = 's3://overlays/fleet'"),
        ("artifacts", "gs://overlays/fleet", "artifacts = 's3://overlays/fleet'"),
        ("model", "/tmp/evil.toml", "model = '/models'"),  # noqa: S108
        ("model", "/models/../tmp/evil.toml", "model = '/models'"),
        ("weights", "/models", "weights is empty"),
        ("predictions", "s3://answers", "predictions is empty"),
    ],
)
def test_anything_else_is_refused_in_a_sentence_that_names_the_setting(
    setting: str, named: str, own: str
) -> None:
    said = refusal(asked(**{setting: named}), worker(ELSEWHERE))
    assert repr(named) in said
    assert f"the worker's own setting {own};" in said
    assert f"COUNTERPOINT_{setting.upper()}" in said


def test_local_places_are_compared_as_they_are_on_this_machine(tmp_path: Path) -> None:
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "out").symlink_to(tmp_path)
    ours = str(tmp_path / "ours")
    assert is_inside((tmp_path / "ours" / "deep er").as_uri(), ours)
    assert is_inside(ours, (tmp_path / "ours").as_uri())
    assert not is_inside(f"{ours}/out/theirs", ours)
