"""The service as seen from outside: verbs that are asked, and scenes that are watched."""

import queue
from collections.abc import Iterator, Sequence
from functools import partial
from threading import Event
from typing import Final

import structlog
import zenoh
from pydantic import BaseModel, ValidationError

from schemas import keys
from schemas.ask import ask_until
from schemas.bus import client_session, is_connected
from schemas.events import SceneNumber
from schemas.keys import Verb
from schemas.score import SceneScore
from schemas.wire import decode, encode, sha256
from service.merging import SceneEvent, SceneMerge
from service.messages import SceneRequest, SelectRequest, TopReply, TopRequest
from service.ranking import RankedScene
from service.selection import Selection
from service.status import Status

log = structlog.get_logger(__name__)

PATIENCE_S: Final = 3.0
"""How long a person waits for a service that is just starting."""

PAGE: Final = 500
PAGE_TIMEOUT_S: Final = 5.0
"""Scenes of the history in one question, which takes milliseconds, and how long it may take."""

IDLE_S: Final = 2.0
"""After so long without a scene, ask whether one was lost on its way: the last leaves no gap."""


class ControlClient:
    """Asks a running service; each question on a session of its own, which opens in milliseconds.

    Every method raises `TransientError` when there is no router or no service, and `PermanentError`
    when the service refuses.
    """

    def __init__(self, connect: Sequence[str], *, root: str) -> None:
        """Take the endpoints of routers, and the first part of every key."""
        self._connect, self._root = tuple(connect), root

    def top(self) -> list[RankedScene]:
        """Rank every current scene, best first."""
        return list(decode(TopReply, self._ask("top", TopRequest())).scenes)

    def select(self, *, budget: int, name: str | None = None) -> Selection:
        """Store the best distinct scenes as a named selection, and publish it."""
        return decode(Selection, self._ask("select", SelectRequest(budget=budget, name=name)))

    def status(self) -> Status:
        """Say how far everything is."""
        return decode(Status, self._ask("status"))

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene."""
        return decode(SceneScore, self._ask("scene", SceneRequest(scene_id=scene_id)))

    def overlay(self, scene_id: str) -> bytes:
        """Return the stored points of a current scene, encoded."""
        return self._ask("overlay", SceneRequest(scene_id=scene_id))

    def _ask(self, verb: Verb, request: BaseModel | None = None) -> bytes:
        with client_session(self._connect) as session:
            return ask_until(
                session,
                keys.control(root=self._root, verb=verb),
                encode(request) if request is not None else b"",
                stop=Event(),
                patience_s=PATIENCE_S,
            )


def watch_scenes(
    connect: Sequence[str],
    *,
    root: str,
    history: int | None = None,
    stop: Event | None = None,
    idle_s: float = IDLE_S,
) -> Iterator[SceneEvent]:
    """Yield scored scenes, each once: those there are, then each as it is committed.

    Subscribes first and asks for the history second, so that nothing falls between; what is lost on
    the way later is noticed by a gap in the numbers, or by asking when it is quiet, and fetched.
    Router and service may be restarted meanwhile.

    Args:
        connect: Endpoints of routers.
        root: First part of every key.
        history: Only so many scenes of the past, the newest; None: all of them.
        stop: Ends the iteration.
        idle_s: How long it must be quiet before asking.

    Raises:
        TransientError: If no router answers at the start.
    """
    stop = stop or Event()
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with (
        client_session(connect) as session,
        session.declare_subscriber(keys.all_scenes(root=root), arrived.put),
    ):
        merge = SceneMerge(partial(_history, session, root), page=PAGE)
        yield from merge.begin(history)
        while not stop.is_set():
            try:
                sample = arrived.get(timeout=idle_s)
            except queue.Empty:
                yield from merge.catch_up()
                continue
            event = _event(sample, root=root)
            if event is not None:
                yield from merge.take(event)


def _history(session: zenoh.Session, root: str, asked: dict[str, int]) -> Iterator[SceneEvent]:
    """Ask for a page of the history; an answer cut short is complete up to its last scene."""
    # Measured: where a session has a subscriber for the same wildcard, a question without a router
    # is not answered empty at once, as others are, but only when its time is up.
    if not is_connected(session):
        return
    parameters = ";".join(f"{name}={number}" for name, number in asked.items())
    for reply in session.get(
        f"{keys.all_scenes(root=root)}?{parameters}",
        timeout=PAGE_TIMEOUT_S,
        consolidation=zenoh.ConsolidationMode.NONE,  # any other merges replies
    ):
        event = _event(reply.ok, root=root) if reply.ok is not None else None
        if event is None:
            return
        yield event


def _event(sample: zenoh.Sample, *, root: str) -> SceneEvent | None:
    """Read a sample; None, and a warning, for what a stranger put there."""
    key = str(sample.key_expr)
    try:
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
        seq = decode(SceneNumber, attachment).seq
        scene_id = keys.scene_id_of(key, root=root)
        if sample.kind == zenoh.SampleKind.DELETE:
            return SceneEvent(seq, scene_id)
        record = sample.payload.to_bytes()
        decode(SceneScore, record)
    except (ValidationError, ValueError) as error:
        log.warning("not a scene", key=key, problem=str(error).splitlines()[0])
        return None
    return SceneEvent(seq, scene_id, record, sha256(record))
