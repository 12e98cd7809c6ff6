"""Client for notebooks and scripts: the verbs by keywords, over HTTP or over the bus."""

import secrets
import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.keys import DEFAULT_ROOT
from schemas.transport.locks import OPEN, Locks
from schemas.transport.overlay_codec import decode_overlay
from schemas.verdict import VerdictRow
from service.api.messages import checked_request
from service.client.client import ControlClient
from service.client.merge import SceneEvent
from service.client.over_http import TIMEOUT_S, HttpClient
from service.client.rows import Rows, rows_of
from service.client.watching import watch_scenes
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.candidates import Choice
from service.curation.comparison import CompareRequest, Comparison
from service.curation.listing import MAX_PAGE, ListedScene, ScenesRequest
from service.curation.mode_rows import ModeRow
from service.curation.ranking import RankedScene
from service.curation.rates import RateRow, instants_ns, rates_request
from service.curation.selection import Selection, SelectionSummary, SelectionTerms
from service.curation.status import Status
from service.curation.strategies.catalogue import DEFAULT
from service.curation.verdicts import (
    MAX_VERDICTS_ASKED,
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)
from service.errors import UsageError

HTTP: Final = ("http://", "https://")


class Counterpoint:
    """Scenes, selections, failure modes and verdicts of one Counterpoint.

    Every method raises `TransientError` when nothing answers, and `PermanentError` with one
    sentence when the request is refused.

    Example:
        `Counterpoint("http://127.0.0.1:8087").scenes(min_score=0.5).to_dataframe()`

    Attributes:
        client: The client by requests, with every verb.
    """

    def __init__(
        self,
        address: str,
        *,
        token: str = "",
        root: str = DEFAULT_ROOT,
        timeout_s: float = TIMEOUT_S,
        locks: Locks = OPEN,
    ) -> None:
        """Keep where requests go; nothing is asked yet.

        Args:
            address: URL of the review page, `http://HOST:PORT`, or endpoint of a router,
                `tcp/HOST:PORT`; commas for several endpoints.
            token: Over HTTP, the token that the page asks for; empty: none.
            root: Over the bus, the first part of every key.
            timeout_s: Over HTTP, the time in which a part of an answer has to come, seconds.
            locks: Over the bus, certificates, where the router is reached by TLS.

        Raises:
            UsageError: If it is no address.
        """
        self.client: ControlClient
        self._endpoints, self._root = tuple(address.split(",")), root
        self._locks = locks
        if address.startswith(HTTP):
            self.client = HttpClient(address, token=token, timeout_s=timeout_s)
        elif "/" in address and "://" not in address:
            self.client = ControlClient(self._endpoints, root=root, locks=locks)
        else:
            raise UsageError(
                f"no address: {address!r}; it is like http://127.0.0.1:8087, or tcp/127.0.0.1:7447"
            )

    def scenes(self, *, since: str = "", until: str = "", **filters: Any) -> Rows[ListedScene]:
        """List current scenes, fetched page by page when they are needed.

        Args:
            since: Recorded at or after: `2026-11-20`, `2026-11-20T08:00:00Z`, or an age (`7d`).
            until: Recorded before, as `since`.
            filters: Fields of `ScenesRequest`: `min_score`, `vehicle`, `kind`, `class_name`,
                `wrong`, `beyond_m`, `within_m`, `judged`, `log`, `text`, `selection`, `sort` and
                more.

        Raises:
            UsageError: If there is no such filter, or a value is impossible.
        """
        times = self._times(since, until)
        asked = checked_request(ScenesRequest, **{"most": MAX_PAGE} | times | filters)

        def pages() -> Iterator[Sequence[ListedScene]]:
            following = asked
            while True:
                page = self.client.scenes(following)
                yield page.rows
                if not page.next:
                    return
                following = following.model_copy(update={"after": page.next})

        return Rows(pages)

    def top(self, most: int | None = 100) -> Rows[RankedScene]:
        """Rank current scenes, best first, with their twins; None: all."""
        return rows_of(self.client.top(most))

    def scene(self, scene_id: str) -> SceneScore:
        """Return the record of a current scene: score, reasons, tracks, evidence."""
        return self.client.scene(scene_id)

    def overlay(self, scene_id: str) -> Overlay:
        """Return the points of a current scene with the labels of both streams.

        Raises:
            PackUnreadableError: If it is damaged.
        """
        payload = self.client.overlay(scene_id)
        where = self.client.overlay_place(scene_id)
        return decode_overlay(payload, scene_id=scene_id, where=where)

    def selections(self) -> Rows[SelectionSummary]:
        """List every stored selection without its scenes, oldest first."""
        return rows_of(self.client.selections())

    def selection(self, name: str) -> Selection:
        """Return a stored selection, with the verdicts on its scenes."""
        return self.client.selection(name)

    def propose(
        self, budget: int, *, strategy: str = DEFAULT, again: bool = False, **filters: Any
    ) -> Rows[Choice]:
        """Return the choice that `select` would store, each scene with its reason.

        Args:
            budget: Scenes that the labellers can take.
            strategy: Name of a selection strategy.
            again: Choose as if no earlier selection had taken any scene.
            filters: As those of `scenes`.
        """
        terms = self._terms(strategy, filters, again=again)
        return rows_of(self.client.propose(budget=budget, terms=terms).choices)

    def select(
        self,
        budget: int,
        *,
        name: str,
        scenes: Sequence[str] | None = None,
        strategy: str = DEFAULT,
        again: bool = False,
        **filters: Any,
    ) -> Selection:
        """Choose scenes, or take these, and store them under a name.

        A selection never changes; the same name with the same choice is no error.

        Args:
            budget: Scenes that the labellers can take.
            name: Name of the selection.
            scenes: Ids of scenes that a person chose; None: the strategy chooses.
            strategy: Name of a selection strategy.
            again: Choose as if no earlier selection had taken any scene.
            filters: As those of `scenes`.
        """
        terms = self._terms(strategy, filters, again=again)
        return self.client.select(budget=budget, name=name, scenes=scenes, terms=terms)

    def modes(self) -> Rows[ModeRow]:
        """Group strong tracks into failure modes, the most frequent first."""
        return rows_of(self.client.modes().modes)

    def compare(self, a: dict[str, Any], b: dict[str, Any], **terms: Any) -> Comparison:
        """Compare two versions: fields of `ComparedSide` for each, and of `ComparisonTerms`."""
        return self.client.compare(checked_request(CompareRequest, a=a, b=b, terms=terms))

    def rates(self, by: str = "vehicle", *, since: str = "", until: str = "") -> Rows[RateRow]:
        """Count contradictions by `vehicle`, `version`, `kind`, `hour` or `log`."""
        return rows_of(self.client.rates(rates_request(by, since=since, until=until, now_s=_now())))

    def activity(self, **fields: Any) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        return self.client.activity(checked_request(ActivityRequest, **fields))

    def verdicts(self, **fields: Any) -> Rows[VerdictRow]:
        """List verdicts, latest first; fields of `VerdictsRequest` filter them."""
        asked = checked_request(VerdictsRequest, **{"most": MAX_VERDICTS_ASKED} | fields)

        def pages() -> Iterator[Sequence[VerdictRow]]:
            following = asked
            while True:
                page = self.client.verdicts(following)
                yield page.rows
                if page.next is None:
                    return
                following = following.model_copy(update={"before": page.next})

        return Rows(pages)

    def judge(self, scene_id: str, verdict: str, *, reviewer: str, **fields: Any) -> VerdictRow:
        """Store a verdict; fields of `JudgeRequest` add a track, a cause or a note.

        A `key` makes the write idempotent: the same request with it is stored once.
        """
        given = {"key": secrets.token_urlsafe(18)} | fields
        asked = checked_request(
            JudgeRequest, scene_id=scene_id, verdict=verdict, reviewer=reviewer, **given
        )
        return self.client.judge(asked)

    def undo(self, *, reviewer: str, **fields: Any) -> VerdictRow:
        """Undo a reviewer's last verdict: of a scene or track, or of all."""
        given = {"key": secrets.token_urlsafe(18)} | fields
        return self.client.undo(checked_request(UndoRequest, reviewer=reviewer, **given))

    def agreement(self, selection: str | None = None) -> AgreementReply:
        """Return agreement, conflicts, pace and precision, of all verdicts or of a selection's."""
        return self.client.agreement(checked_request(AgreementRequest, selection=selection))

    def choices(self) -> ChoicesReply:
        """Return the values that filters and verdicts choose from."""
        return self.client.choices()

    def status(self) -> Status:
        """Return the progress of planning and mining."""
        return self.client.status()

    def watch(self, **options: Any) -> Iterator[SceneEvent]:
        """Yield scored scenes, existing and new ones; the options are those of `watch_scenes`.

        Raises:
            UsageError: If the address is a page: scenes are published on the bus.
        """
        if isinstance(self.client, HttpClient):
            raise UsageError("scenes are published on the bus: give the endpoint of a router")
        return watch_scenes(self._endpoints, root=self._root, locks=self._locks, **options)

    def _terms(self, strategy: str, filters: dict[str, Any], *, again: bool) -> SelectionTerms:
        asked = None
        if filters:
            times = self._times(filters.pop("since", ""), filters.pop("until", ""))
            asked = checked_request(ScenesRequest, **times | filters)
        return checked_request(SelectionTerms, strategy=strategy, again=again, filters=asked)

    @staticmethod
    def _times(since: str, until: str) -> dict[str, int]:
        since_ns, until_ns = instants_ns(since=since, until=until, now_s=_now())
        times = {"since_ns": since_ns} if since_ns else {}
        return times if until_ns is None else times | {"until_ns": until_ns}


def _now() -> float:
    return time.clock_gettime(time.CLOCK_REALTIME)
