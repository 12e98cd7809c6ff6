"""A subscriber made from `schemas/WIRE.md` alone: Zenoh, JSON, and nothing of ours.

Notes every event as a JSON line on stdout: number, scene id, and the record or null. Arguments: the
endpoint, and the number after which to go on.
"""

import json
import queue
import sys
import time
from typing import Any, Final
from urllib.parse import unquote

import zenoh

SCENES: Final = "counterpoint/v1/scene/**"
PAGE, QUIET_S, AGAIN_S = 500, 0.3, 0.1


class Subscriber:
    """Steps 2 to 4 of the page."""

    def __init__(self, session: zenoh.Session, *, last: int) -> None:
        self._session, self._last = session, last

    def catch_up(self) -> None:
        brought = True
        while brought:
            brought = False
            question = f"{SCENES}?since={self._last};most={PAGE};withdrawn=1"
            replies = self._session.get(
                question, consolidation=zenoh.ConsolidationMode.NONE, timeout=5
            )
            for reply in list(replies):
                if reply.ok is None:
                    break
                if (number := _number(reply.ok)) > self._last:
                    self._handle(reply.ok, number)
                    brought = True

    def take(self, sample: zenoh.Sample) -> None:
        number = _number(sample)
        if number == self._last + 1:
            self._handle(sample, number)
        while number > self._last:
            self.catch_up()
            if number > self._last:
                time.sleep(AGAIN_S)

    def _handle(self, sample: zenoh.Sample, number: int) -> None:
        *_, log, scene = str(sample.key_expr).split("/")
        gone = sample.kind == zenoh.SampleKind.DELETE
        record: dict[str, Any] | None = None if gone else json.loads(sample.payload.to_bytes())
        row = {"seq": number, "scene_id": f"{unquote(log)}/{unquote(scene)}", "record": record}
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
        self._last = number


def _number(sample: zenoh.Sample) -> int:
    assert sample.attachment is not None
    number: int = json.loads(sample.attachment.to_bytes())["seq"]
    return number


def main(endpoint: str, last: int) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    arrived: queue.Queue[zenoh.Sample] = queue.Queue()
    with zenoh.open(config) as session, session.declare_subscriber(SCENES, arrived.put):
        subscriber = Subscriber(session, last=last)
        subscriber.catch_up()
        while True:
            try:
                subscriber.take(arrived.get(timeout=QUIET_S))
            except queue.Empty:
                subscriber.catch_up()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
