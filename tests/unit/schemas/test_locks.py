"""Locks that this process cannot use are refused with the setting and the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas.errors import PermanentError
from schemas.transport.locks import Locks, check_locks

NOBODY = 65_534


@contextmanager
def as_another_user() -> Iterator[None]:
    """Run as a user without files here, where the tests run as root: root reads every file."""
    if os.geteuid():
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_key_that_this_user_cannot_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # paths are relative, so folders above need no permission
    for name in ("ca.pem", "service.pem", "service.key"):
        Path(name).write_text("content\n")
    tmp_path.chmod(0o755)
    locks = Locks(ca="ca.pem", certificate="service.pem", key="service.key")
    Path("service.key").chmod(0o600)
    check_locks(locks, ())
    Path("service.key").chmod(0o000)
    refused = r"tls_key: cannot read the file: Permission denied \(service.key\)"
    with as_another_user(), pytest.raises(PermanentError, match=refused):
        check_locks(locks, ())
