"""Clients that ask as fast as they are answered, until the process is ended.

They ask for the status, or commit under leases that do not exist, and name records that were
never sent.
"""

import sys
import threading
import uuid

from schemas.errors import CounterpointError
from schemas.transport import keys
from schemas.transport.ask import ask
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT
from schemas.transport.wire import encode
from schemas.work import CommitRequest, ManifestEntry


def main(endpoint: str, clients: int, verb: str) -> None:
    answered = [threading.Event() for _ in range(clients)]

    def flood(first: threading.Event) -> None:
        with client_session([endpoint]) as session:
            while True:
                payload = _forged_commit() if verb == "commit" else b""
                try:
                    ask(session, keys.control(root=DEFAULT_ROOT, verb=verb), payload, timeout_s=20)
                except CounterpointError:
                    continue
                first.set()

    for each in answered:
        threading.Thread(target=flood, args=(each,)).start()
    for each in answered:
        each.wait()
    sys.stdout.write("flooding\n")
    sys.stdout.flush()


def _forged_commit() -> bytes:
    entry = ManifestEntry(scene_id="log-0000/lidar/1", sha256=uuid.uuid4().hex * 2)
    return encode(CommitRequest(worker_id="forger", lease_id=uuid.uuid4().hex, manifest=(entry,)))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
