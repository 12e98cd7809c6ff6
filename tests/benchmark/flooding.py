"""A client that floods a service: questions to every verb and forged records, as fast as they go.

python -m tests.benchmark.flooding ENDPOINT QUESTIONS FORGED SEED [AUTHORITY NAME]
"""

import json
import random
import sys
import threading
import time
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Final

import zenoh

from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys
from schemas.transport.ask import PROBLEM
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.locks import OPEN
from schemas.transport.wire import encode
from schemas.work import FailRequest, RenewRequest
from service.api.verbs import VERBS
from tests.contracts.ledger_world import score_of
from tests.fuzz.questions import DAMAGES
from tests.integration.quick_miner import locks_of

WAITING: Final = 2_000
"""Questions without an answer at one time: more than a queue of the service takes."""

PATIENCE_S: Final = 30.0

FORGER: Final = "forger"


def flood(session: zenoh.Session, questions: int, forged: int, seed: int) -> Counter[str]:
    """Ask and forge; return how often a question was answered, refused and left alone.

    Args:
        session: On the bus.
        questions: To ask, without waiting for answers while fewer than `WAITING` are open.
        forged: Records to put, among the questions.
        seed: Of their choice.
    """
    rng, ends = random.Random(seed), Counter[str]()  # noqa: S311  # no secret
    room, lock = threading.Semaphore(WAITING), threading.Lock()

    def ask(verb: str, payload: bytes) -> None:
        answers: list[str] = []

        def take(reply: zenoh.Reply) -> None:
            is_problem = reply.err is not None and reply.err.encoding == PROBLEM
            answers.append("answered" if reply.ok else "refused" if is_problem else "left alone")

        def end() -> None:
            with lock:
                ends[answers[0] if answers else "left alone"] += 1
            room.release()

        room.acquire()
        key = keys.control(root=ROOT, verb=verb)
        handler = zenoh.handlers.Callback(take, end)
        session.get(key, handler, payload=payload, timeout=PATIENCE_S)

    every = questions // forged if forged else 0
    for number in range(questions):
        ask(*_question(rng))
        if every and number % every == 0:
            session.put(keys.score(root=ROOT, worker_id=rng.choice(FORGED_IN)), _record(rng))
    for _ in range(WAITING):
        room.acquire()
    return ends


_DAMAGED: Final = tuple(change(b'{"worker_id":"forger"}') for change in DAMAGES.values())

FORGED_IN: Final = (FORGER, "miner-0", "miner-1")
"""Workers in whose names records are forged; two of them exist."""


def _question(rng: random.Random) -> tuple[str, bytes]:
    """Return a verb and a message: half of them right, the rest forged or no message."""
    if rng.random() < 0.5:
        return rng.choice(("status", "top", "rates", "scenes")), b""
    asked = rng.random()
    if asked < 0.4:
        return rng.choice(sorted(VERBS)), rng.choice(_DAMAGED)
    lease_id = f"{rng.getrandbits(128):032x}"
    of = {"worker_id": rng.choice(FORGED_IN), "lease_id": lease_id}
    if asked < 0.6:
        return "renew", encode(RenewRequest(**of))
    if asked < 0.75:
        return "fail", encode(FailRequest(**of, error="x" * 200, permanent=True))
    return "commit", json.dumps(of | {"records": [_record(rng).decode()]}).encode()


def _record(rng: random.Random) -> bytes:
    """Return a record in good form of a scene that was not mined, or one that is too large."""
    record = encode(score_of(f"car-{rng.randrange(1000)}/forged", rng.randrange(1 << 40)))
    return record if rng.random() < 0.8 else record + b" " * MAX_RECORD_BYTES


def main(endpoint: str, questions: str, forged: str, seed: str, *locks: str) -> None:
    """Flood, and print one JSON line: how the questions ended, and seconds."""
    held = locks_of(Path(locks[0]), locks[1]) if locks else OPEN
    with closing(client_session([endpoint], locks=held)) as session:
        began_s = time.monotonic()
        ends = flood(session, int(questions), int(forged), int(seed))
        line = {"ends": ends, "seconds": round(time.monotonic() - began_s, 2)}
        sys.stdout.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
