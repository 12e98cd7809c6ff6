"""Credentials that are missing or wrong at the start: one sentence, and no secret in it."""

from pathlib import Path

import pytest

from schemas.transport.bus import router_session
from service.cli.main import main
from tests.free_ports import free_endpoint
from tests.integration.object_store import Ceph, Identity

pytestmark = pytest.mark.integration

NOBODY = Identity("nobody", "AKNOBODY", "s3cr3t/of+nobody")
CREDENTIALS = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")


def environment_of(case: str, ceph: Ceph) -> dict[str, str]:
    """Return the variables of a case."""
    right = ceph.environment()
    if case == "none":
        return {name: value for name, value in right.items() if name not in CREDENTIALS}
    if case == "unknown":
        return ceph.environment(NOBODY)
    if case == "wrong secret":
        return right | {"AWS_SECRET_ACCESS_KEY": NOBODY.secret}
    return ceph.environment(ceph.make_user())


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ("none", "no credentials for the bucket: set AWS_ACCESS_KEY_ID, "),
        ("unknown", "the store does not know these credentials (InvalidAccessKeyId): set AWS_"),
        ("wrong secret", "the store refuses these credentials (SignatureDoesNotMatch): set AWS_"),
        ("not allowed", "the store denies these credentials listing here (AccessDenied): "),
    ],
)
def test_credentials_that_do_not_open_the_bucket_end_the_start_in_one_sentence(
    ceph: Ceph,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    case: str,
    says: str,
) -> None:
    environment = environment_of(case, ceph)
    for name in (*CREDENTIALS, "AWS_SESSION_TOKEN", "AWS_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("COUNTERPOINT_HTTP_LISTEN", "")
    bucket, endpoint = f"s3://{ceph.make_bucket()}", free_endpoint()
    with router_session([endpoint]):
        arguments = ["--bucket", bucket, "--state", str(tmp_path / "state"), "--connect", endpoint]
        assert main(["service", *arguments]) == 1
    heard = capsys.readouterr()
    said = " ".join((heard.out + heard.err).split())
    assert f"error: {says}" in said
    assert bucket in said
    assert not any(environment.get(name, NOBODY.secret) in said for name in CREDENTIALS)
