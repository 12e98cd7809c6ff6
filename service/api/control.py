"""Handlers of the verbs of workers and users; each maps a payload to a reply payload."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from itertools import groupby
from operator import attrgetter
from typing import Any, Final

import structlog
from pydantic import BaseModel, ValidationError

from schemas.backlog import WorkBacklog
from schemas.errors import PermanentError
from schemas.mining import MiningSettings
from schemas.transport import keys
from schemas.transport.wire import decode, encode
from schemas.verdict import VerdictRow
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    FailRequest,
    NothingToDo,
    RenewRequest,
)
from service.api.expected_versions import UNEXPECTED_REST_S, ExpectedVersions
from service.api.held_leases import HeldLeases
from service.api.learned_top import learned_top
from service.api.messages import (
    AboutReply,
    ProposeRequest,
    RatesReply,
    RetryReply,
    RetryRequest,
    SceneRequest,
    SelectionRequest,
    SelectionsReply,
    SelectRequest,
    TopReply,
    TopRequest,
    VerdictsReply,
    verdicts_reply,
)
from service.api.reader import no_such_scene, no_such_selection
from service.api.request_queue import RequestQueue, malformed
from service.api.sparse_log import SparseLog
from service.api.staging import Staging
from service.api.stored_overlays import read_overlay
from service.api.verbs import OF_PEOPLE, OF_WORKERS, VERBS
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.audit import AuditedReply, AuditReply, AuditRequest, ExportedRequest
from service.curation.candidates import Proposal
from service.curation.comparison import CompareRequest, Comparison
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.mode_rows import ModesReply
from service.curation.rates import RatesRequest, rates, with_judged
from service.curation.selection import Selection
from service.curation.status import Status
from service.curation.strategies.catalogue import strategy_of
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    ChoicesReply,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
    need_cause,
)
from service.store.audit import actor
from service.store.ledger import Ledger, StoredScene

log = structlog.get_logger(__name__)

STAGING_PATIENCE_S: Final = 0.2
"""Longest wait of a commit for records that it may have overtaken, seconds."""


class Control:
    """Answers every verb of `service.api.verbs`; what it acknowledges is on disk.

    Verb `x` is answered by `answer_x`, which takes the request that the row names, None for none.

    Attributes:
        leases: Leases that are known to be held.
    """

    def __init__(
        self,
        *,
        settings: MiningSettings,
        ledger: Ledger,
        staging: Staging,
        on_scenes: Callable[[], None],
        on_selection: Callable[[Selection], None],
        on_commit_seconds: Callable[[float], None] = lambda _: None,
        on_comparison: Callable[[Comparison], None] = lambda _: None,
        causes: Sequence[str] = (),
        versions: ExpectedVersions | None = None,
    ) -> None:
        """Keep the parts, the user's own causes of verdicts, and the callbacks.

        `versions` decides which pipeline versions get leases; None: any.

        `on_scenes` is called after each commit and each verdict, which are published then.
        `on_commit_seconds` is called with the time that the ledger took for each commit, and
        `on_comparison` with the result of each comparison.
        """
        self._on_commit_seconds, self._causes = on_commit_seconds, tuple(causes)
        self._versions = versions or ExpectedVersions(takes_any=True)
        self._on_comparison, self.leases = on_comparison, HeldLeases()
        self._settings, self._ledger, self._staging = settings, ledger, staging
        self._on_scenes, self._on_selection = on_scenes, on_selection
        self._refusals = SparseLog()
        self._about = AboutReply(package=version("counterpoint"))  # an upgrade changes the files
        self._answers: Mapping[str, Callable[[Any], BaseModel | bytes]] = {
            verb: getattr(self, f"answer_{verb}") for verb in VERBS
        }

    def declare(self, requests: RequestQueue, *, root: str) -> None:
        """Register the handlers of every verb."""
        for verb in VERBS:
            requests.declare(
                keys.control(root=root, verb=verb), partial(self.answer, verb), asked=verb
            )
        for verb in (*OF_WORKERS, *OF_PEOPLE):
            requests.declare_named(
                keys.all_named_control(root=root, verb=verb), partial(self.answer, verb), asked=verb
            )

    def answer(self, verb: str, payload: bytes) -> bytes:
        """Answer one request.

        Raises:
            MalformedError: If the payload does not fit the verb.
            CounterpointError: If the request cannot be answered, or not now.
        """
        kind, request = VERBS[verb].request, None
        if kind is not None:
            try:
                request = decode(kind, payload)
            except ValidationError as error:
                raise malformed(verb, error) from None
            if verb in OF_WORKERS:
                _need_own_id(request)
        answer = self._answers[verb](request)
        return answer if isinstance(answer, bytes) else encode(answer)

    def answer_about(self, _: None) -> AboutReply:
        """Say which program this is."""
        return self._about

    def answer_hello(self, _: None) -> MiningSettings:
        """Say what every worker must do alike."""
        return self._settings

    def answer_claim(self, request: ClaimRequest) -> ClaimReply:
        """Give a lease, if there is work, and the worker's pipeline version is expected."""
        if problem := self._versions.refusal(request.pipeline_version):
            grant = NothingToDo(retry_after_s=UNEXPECTED_REST_S, problem=problem)
            return ClaimReply(grant=grant)
        reply = self._ledger.claim(request)
        if not isinstance(reply.grant, NothingToDo):
            self.leases.add(reply.grant.lease_id)
        return reply

    def answer_renew(self, request: RenewRequest) -> Answer:
        """Lengthen a lease."""
        answer = self._refused(request) or self._ledger.renew(request)
        note = self.leases.add if answer.ok else self.leases.discard
        note(request.lease_id)
        return answer

    def answer_fail(self, request: FailRequest) -> Answer:
        """Take back work that failed."""
        answer = self._refused(request) or self._ledger.fail(request)
        self.leases.discard(request.lease_id)
        return answer

    def answer_backlog(self, _: None) -> WorkBacklog:
        """Count the work that waits and the work that is leased."""
        work = self._ledger.backlog().work
        return WorkBacklog(
            waiting=sum(count for (_kind, state), count in work.items() if state == "ready"),
            leased=sum(count for (_kind, state), count in work.items() if state == "leased"),
        )

    def answer_status(self, _: None) -> Status:
        """Say how far everything is."""
        return self._ledger.status()

    def answer_scene(self, request: SceneRequest) -> bytes:
        """Return the record of a current scene."""
        return self._scene(request).record

    def answer_commit(self, request: CommitRequest) -> Answer:
        """Store what was mined, records from the message or from the bus."""
        answer = self._refused(request) or self._committed(request)
        if answer.problem:
            self._refusals.warn(
                "commit refused",
                asked="commit",
                worker_id=request.worker_id,
                lease_id=request.lease_id,
                problem=answer.problem,
            )
        if answer.ok:
            self.leases.discard(request.lease_id)
            self._on_scenes()
        return answer

    def _committed(self, request: CommitRequest) -> Answer:
        digests = [entry.sha256 for entry in request.manifest]
        patience_s = 0.0 if request.records else STAGING_PATIENCE_S
        staged = self._staging.collect(digests, patience_s=patience_s)
        began_s = time.monotonic()
        answer = self._ledger.commit(request, staged)
        self._on_commit_seconds(time.monotonic() - began_s)
        if answer.ok:
            self._staging.discard(digests)
        return answer

    def _refused(self, request: RenewRequest | CommitRequest | FailRequest) -> Answer | None:
        """Refuse a lease that its worker was not given, before anything waits or is written."""
        if request.lease_id in self.leases:
            return None
        problem = self._ledger.lease_problem(worker_id=request.worker_id, lease_id=request.lease_id)
        return Answer(ok=False, problem=problem) if problem else None

    def answer_top(self, request: TopRequest) -> TopReply:
        """List the ranking, by the score or by what verdicts teach."""
        if request.learned:
            return learned_top(self._ledger, most=request.most)
        rows = self._ledger.ranking(most=request.most)
        if request.verdicts:
            rows = self._ledger.verdicts.with_verdicts(rows)
        else:  # earlier clients refuse what they do not know
            rows = [row.model_copy(update={"place": None}) for row in rows]
        return TopReply(scenes=tuple(rows))

    def answer_modes(self, _: None) -> ModesReply:
        """Group strong tracks into failure modes."""
        return self._ledger.proposals.modes()

    def answer_compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions, and count the result."""
        found = self._ledger.comparisons.compare(request)
        self._on_comparison(found)
        if not found.passed:
            log.warning(
                "a version regressed",
                a=found.a.name,
                b=found.b.name,
                answers_less=found.answers_less,
                groups=[row.group for row in found.groups if row.outcome == "regressed"][:10],
            )
        return found

    def answer_rates(self, request: RatesRequest) -> RatesReply:
        """Count contradictions by group."""
        rows = rates(self._ledger.rate_sums(request), request.by)
        if request.verdicts:
            rows = with_judged(rows, request, self._ledger.verdicts.judged_scenes())
        return RatesReply(rows=tuple(rows))

    def answer_select(self, request: SelectRequest) -> Selection:
        """Make, store and publish a selection."""
        chosen = self._ledger.proposals.select(
            budget=request.budget, name=request.name, terms=request.terms, wanted=request.scenes
        )
        selection = self._ledger.selections.save(
            request.name,
            budget=request.budget,
            scenes=chosen,
            strategy=strategy_of(request.scenes, request.terms.strategy),
        )
        self._on_selection(selection)
        return self._ledger.verdicts.in_selection(selection) if request.verdicts else selection

    def answer_propose(self, request: ProposeRequest) -> Proposal:
        """Return the choice that a selection would store, with its reasons."""
        return self._ledger.proposals.propose(
            budget=request.budget, name=request.name, terms=request.terms
        )

    def answer_selection(self, request: SelectionRequest) -> Selection:
        """Return one stored selection."""
        found = self._ledger.selections.one(request.name)
        if found is None:
            raise no_such_selection(request.name)
        return self._ledger.verdicts.in_selection(found) if request.verdicts else found

    def answer_selections(self, _: None) -> SelectionsReply:
        """List every stored selection, without its scenes."""
        return SelectionsReply(selections=tuple(self._ledger.selections.listed()))

    def answer_scenes(self, request: ScenesRequest) -> ScenesReply:
        """Return a page of current scenes."""
        return self._ledger.listing(request)

    def answer_judge(self, request: JudgeRequest) -> VerdictRow:
        """Store and publish a verdict."""
        need_cause(request.cause, self._causes)
        stored = self._ledger.verdicts.judge(request)
        self._on_scenes()
        return stored

    def answer_undo(self, request: UndoRequest) -> VerdictRow:
        """Undo a reviewer's last verdict, and publish that."""
        stored = self._ledger.verdicts.undo(request)
        self._on_scenes()
        return stored

    def answer_verdicts(self, request: VerdictsRequest) -> VerdictsReply:
        """Return a page of verdicts, latest first."""
        return verdicts_reply(self._ledger.verdicts.page(request), most=request.most)

    def answer_agreement(self, request: AgreementRequest) -> AgreementReply:
        """Sum up the verdicts that count."""
        return self._ledger.verdicts.agreement(request)

    def answer_activity(self, request: ActivityRequest) -> ActivityReply:
        """Sum up scenes and verdicts over time and by group."""
        return self._ledger.activity(request)

    def answer_choices(self, _: None) -> ChoicesReply:
        """List the values that filters and verdicts choose from."""
        return self._ledger.choices(causes=self._causes)

    def answer_retry(self, request: RetryRequest) -> RetryReply:
        """Try parked work, or refused plans, again."""
        retried = self._ledger.retry(request.log_ids, refused=request.refused)
        for log_id, works in groupby(retried, key=attrgetter("log_id")):
            ended = list(works)
            log.info(
                "work is tried again",
                log_id=log_id,
                works=len(ended),
                shard=ended[0].shard or None,
                before=ended[0].error,
            )
        return RetryReply(retried=tuple(retried))

    def answer_exported(self, request: ExportedRequest) -> AuditedReply:
        """Note an export in the audit log."""
        return AuditedReply(ordinal=self._ledger.audit_log.exported(request))

    def answer_audit(self, request: AuditRequest) -> AuditReply:
        """Return a page of the audit log."""
        return AuditReply(rows=tuple(self._ledger.audit_log.page(request)))

    def _scene(self, request: SceneRequest) -> StoredScene:
        stored = self._ledger.scene(request.scene_id, withdrawn=request.withdrawn)
        if stored is None:
            raise no_such_scene(request.scene_id)
        return stored

    def answer_overlay(self, request: SceneRequest) -> bytes:
        """Return the stored points of a current scene."""
        return read_overlay(self._settings.artifacts, self._scene(request))


def _need_own_id(request: Any) -> None:
    """Refuse a request under the id of another worker than the one that its key names.

    Raises:
        PermanentError: If the two differ. A key without a name proves nothing, and is accepted:
            where rules of access control are in force, none of a worker reaches the service.
    """
    name = actor().name
    if name and name != request.worker_id:
        raise PermanentError(f"worker {name} asked in the name of {request.worker_id}")
