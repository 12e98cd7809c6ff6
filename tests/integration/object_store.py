"""A real S3 server for tests: a Ceph gateway, its users and buckets; killed and started at will."""

import base64
import hmac
import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from email.utils import formatdate
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Final
from urllib.parse import urlencode

import obstore.store

from schemas.transport.bucket import Bucket, open_bucket

PROGRAMS: Final = ("radosgw", "radosgw-admin", "ceph-mon", "ceph-osd", "curl")
PACKAGES: Final = "radosgw ceph-mon ceph-osd curl"
REGION: Final = "us-east-1"
_DEADLINE_S: Final = 120.0
_PORTS: Final = (20_000, 30_000)

# Measured: on a busy machine one start in two fails with "wrong fsid", since the disk's process
# may give its first order before the monitor has told it which cluster this is.
_PATIENT_OSD: Final = """#!/bin/sh
for _ in 1 2 3 4 5 6 7 8 9; do {path} "$@" && exit; sleep 0.5; done
exec {path} "$@"
"""

READ: Final = ("s3:GetObject", "s3:ListBucket")
OVERLAYS: Final = ("s3:GetObject", "s3:PutObject")
"""What the log bucket and the bucket of overlays must allow."""


@dataclass(frozen=True, slots=True)
class Identity:
    """A user of the store with one pair of keys."""

    name: str
    key_id: str
    secret: str


ADMIN: Final = Identity("test", "AKTEST", "SKTEST")
"""Whom the script that starts the store creates; owner of every bucket made here."""


class Ceph:
    """Monitor, disk and gateway of one store, all under one folder; only the gateway is killed.

    Attributes:
        endpoint: URL of the gateway, the same after each restart.
    """

    def __init__(self, scripts: Path, folder: Path) -> None:
        """Prepare; `up` starts it.

        Args:
            scripts: Folder of `ceph-up.sh`.
            folder: For all its state; its path must be short, sockets are made in it.
        """
        self._scripts, self._folder = scripts, folder
        self._users, self._buckets, self._port = 0, 0, _free_ports()
        self.endpoint = f"http://127.0.0.1:{self._port}"

    def up(self) -> None:
        """Start everything, and make the gateway's pools by a first write.

        A monitor that is asked before it is ready on a busy machine ends the start: once more then.
        """
        if problem := self._begin():
            self.down()
            shutil.rmtree(self._folder)
            self._folder.mkdir()
            if again := self._begin():
                raise RuntimeError(f"ceph-up.sh failed twice:\n{problem}\n{again}")
        self.open(self.make_bucket()).put("first", b"")

    def _begin(self) -> str:
        programs = self._folder / "programs"
        programs.mkdir()
        (programs / "ceph-osd").write_text(_PATIENT_OSD.format(path=shutil.which("ceph-osd")))
        (programs / "ceph-osd").chmod(0o755)
        begun = subprocess.run(
            ["bash", self._scripts / "ceph-up.sh", self._folder, str(self._port)],
            env=os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
        )
        return (begun.stdout + begun.stderr)[-3000:] if begun.returncode else ""

    def down(self) -> None:
        """Kill every process: nothing of the store is wanted any more."""
        for path in self._folder.glob("*.pid"):
            pid = int(path.read_text() or "0")
            if pid and _is_running(pid):
                os.kill(pid, signal.SIGKILL)
                self._await_end(pid)

    def make_bucket(self) -> str:
        """Make an empty bucket and return its name."""
        self._buckets += 1
        name = f"bucket-{self._buckets}"
        self._ask("PUT", f"/{name}")
        return name

    def make_user(self, *, op_mask: str = "") -> Identity:
        """Make a user that owns nothing; an op mask (`read`) limits it in every bucket."""
        self._users += 1
        user = Identity(
            f"user-{self._users}", f"AKUSER{self._users}", f"s3cr3t/of+user{self._users}"
        )
        mask = [f"--op-mask={op_mask}"] if op_mask else []
        self._administer("user", "create", f"--display-name={user.name}", *_named(user), *mask)
        return user

    def allow(self, bucket: str, who: Mapping[Identity, Sequence[str]]) -> None:
        """Set the policy of a bucket: whom it allows what; everything else only to its owner."""
        both = [f"arn:aws:s3:::{bucket}", f"arn:aws:s3:::{bucket}/*"]
        statements = [
            {
                "Effect": "Allow",
                "Principal": {"AWS": [f"arn:aws:iam:::user/{user.name}"]},
                "Action": list(actions),
                "Resource": both,
            }
            for user, actions in who.items()
        ]
        policy = {"Version": "2012-10-17", "Statement": statements}
        self._ask("PUT", f"/{bucket}?policy", json.dumps(policy).encode())

    def notify(self, bucket: str, url: str) -> None:
        """Have every change in a bucket posted to a URL, in the form of S3 events."""
        wanted = {
            "Action": "CreateTopic",
            "Name": f"topic-{bucket}",
            "Attributes.entry.1.key": "push-endpoint",
            "Attributes.entry.1.value": url,
            "Attributes.entry.2.key": "persistent",
            "Attributes.entry.2.value": "false",
        }
        form = "application/x-www-form-urlencoded; charset=utf-8"
        said = self._ask("POST", "/", urlencode(wanted).encode(), content_type=form)
        found = re.search(r"<TopicArn>(.*)</TopicArn>", said)
        assert found is not None, said
        events = ("s3:ObjectCreated:*", "s3:ObjectRemoved:*")
        named = "".join(f"<Event>{event}</Event>" for event in events)
        configured = (
            '<NotificationConfiguration xmlns="http://s3.amazonaws.com/doc/2006-03-01/">'
            f"<TopicConfiguration><Id>counterpoint</Id><Topic>{found[1]}</Topic>{named}"
            "</TopicConfiguration></NotificationConfiguration>"
        )
        self._ask("PUT", f"/{bucket}?notification", configured.encode())

    def delete(self, bucket: str, key: str) -> None:
        """Delete one object by a request of its own."""
        self._ask("DELETE", f"/{bucket}/{key}")

    def remove_key(self, user: Identity) -> None:
        """Take a user's keys away: they are refused from now on."""
        key = (f"--uid={user.name}", f"--access-key={user.key_id}")
        self._administer("key", "rm", "--key-type=s3", *key)

    def give_new_key(self, user: Identity) -> Identity:
        """Give a user other keys, and return the user with them."""
        new = replace(user, key_id=f"{user.key_id}N", secret=f"{user.secret}N")
        self._administer("key", "create", "--key-type=s3", *_named(new))
        return new

    def options(self, user: Identity = ADMIN) -> dict[str, str]:
        """Return what `open_bucket` needs to act as this user."""
        return {
            "endpoint": self.endpoint,
            "region": REGION,
            "access_key_id": user.key_id,
            "secret_access_key": user.secret,
        }

    def environment(self, user: Identity = ADMIN, *, endpoint: str = "") -> dict[str, str]:
        """Return the variables under which a process acts as this user."""
        return {
            "AWS_ENDPOINT_URL": endpoint or self.endpoint,
            "AWS_REGION": REGION,
            "AWS_ACCESS_KEY_ID": user.key_id,
            "AWS_SECRET_ACCESS_KEY": user.secret,
        }

    def open(self, bucket: str, user: Identity = ADMIN) -> Bucket:
        """Open a bucket as the product does."""
        return open_bucket(f"s3://{bucket}", options=self.options(user))

    def store(self, bucket: str) -> obstore.store.S3Store:
        """Open a bucket as its owner, to delete in it, which the product cannot."""
        options = {"allow_http": True}
        return obstore.store.S3Store(bucket, config=self.options(), client_options=options)  # type: ignore[arg-type]

    def kill(self) -> None:
        """Kill the gateway without a warning."""
        pid = int((self._folder / "client.rgw.pid").read_text())
        os.kill(pid, signal.SIGKILL)
        self._await_end(pid)

    def send(self, sent: signal.Signals) -> None:
        """Send a signal to the gateway, such as one that freezes it."""
        os.kill(int((self._folder / "client.rgw.pid").read_text()), sent)

    def start(self) -> None:
        """Start the gateway again, if it does not run, and wait until it answers."""
        if _is_running(int((self._folder / "client.rgw.pid").read_text() or "0")):
            return
        configured = ("-c", str(self._folder / "ceph.conf"), "-n", "client.rgw")
        subprocess.run(["radosgw", *configured], check=True, capture_output=True)
        end_s = time.monotonic() + _DEADLINE_S
        while not self._answers():
            assert time.monotonic() < end_s, "the gateway did not come up again"
            time.sleep(0.05)

    def _await_end(self, pid: int) -> None:
        end_s = time.monotonic() + _DEADLINE_S
        while _is_running(pid):
            assert time.monotonic() < end_s, f"process {pid} does not end"
            time.sleep(0.02)

    def _answers(self) -> bool:
        try:
            with socket.create_connection(("127.0.0.1", self._port), timeout=1):
                return True
        except OSError:
            return False

    def _administer(self, *command: str) -> None:
        configured = ("-c", str(self._folder / "ceph.conf"), "-n", "client.rgw")
        done = subprocess.run(
            ["radosgw-admin", *configured, *command], capture_output=True, text=True
        )
        if done.returncode:
            raise RuntimeError(f"radosgw-admin {' '.join(command)}: {done.stderr[-2000:]}")

    def _ask(self, method: str, path: str, body: bytes = b"", *, content_type: str = "") -> str:
        """Send a request that obstore has no word for, signed as S3 took it first (version 2)."""
        date = formatdate(usegmt=True)
        signed = hmac.digest(
            ADMIN.secret.encode(), f"{method}\n\n{content_type}\n{date}\n{path}".encode(), "sha1"
        )
        signature = base64.b64encode(signed).decode()
        connection = HTTPConnection("127.0.0.1", self._port, timeout=_DEADLINE_S)
        try:
            headers = {"Date": date, "Authorization": f"AWS {ADMIN.key_id}:{signature}"}
            if content_type:
                headers["Content-Type"] = content_type
            connection.request(method, path, body=body, headers=headers)
            reply = connection.getresponse()
            said = reply.read()
        finally:
            connection.close()
        if reply.status >= 300:
            raise HTTPException(f"{method} {path}: {reply.status} {said.decode(errors='replace')}")
        return said.decode()


def missing_programs() -> list[str]:
    """Name the programs that the store needs and this machine lacks."""
    return [program for program in PROGRAMS if shutil.which(program) is None]


def _named(user: Identity) -> tuple[str, ...]:
    return (f"--uid={user.name}", f"--access-key={user.key_id}", f"--secret-key={user.secret}")


def _free_ports() -> int:
    """Find a port that is free together with the next, which the monitor takes.

    They lie below those that the kernel hands out, which anybody may get a moment later.
    """
    while True:
        port = random.randrange(*_PORTS, 2)  # noqa: S311  # two test runs must not draw alike
        try:
            for each in (port, port + 1):
                socket.create_server(("127.0.0.1", each)).close()
        except OSError:
            continue
        return port


def _is_running(pid: int) -> bool:
    """Whether any thread of a process is left: the first may be a zombie while others listen."""
    process = Path(f"/proc/{pid}")
    try:
        stat = (process / "stat").read_text()
        threads = len(list((process / "task").iterdir()))
    except OSError:  # it ended before, or while this was read
        return False
    return threads > 1 or stat.rpartition(")")[2].split()[0] != "Z"
