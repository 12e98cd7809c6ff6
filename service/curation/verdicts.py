"""Verdicts of reviewers: what is asked, what counts, agreement, pace and precision. Pure."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from hashlib import sha256
from itertools import combinations
from statistics import median
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count, Digest, Finite, Kept, Name, SceneId, Seconds, Tally
from schemas.score import Share
from schemas.verdict import (
    DECIDED,
    GIVEN,
    RIGHT,
    Cause,
    Note,
    Verdict,
    VerdictRow,
    WriteKey,
)
from service.errors import UsageError

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")

CAUSES: Final = {
    "unseen_class": "an object of a class that the model was not trained on",
    "fast_oncoming": "fast oncoming traffic, labelled static",
    "brief_stop": "traffic that stops briefly, as at a red light",
    "small_cluster": "a small fragment of an object",
    "merged_cluster": "one cluster of several objects",
    "odometry": "poses that err in a turn or on a bump",
    "ground": "ground, or vegetation and spray near it",
    "occlusion": "an object that is hidden for a time",
    "common_mode": "both streams wrong in the same way",
}
"""Taxonomy of causes, in the order of their keys on the page. Most are failures that the paper
lists:
unseen objects, fast oncoming traffic, stops at red lights, faults of clusters, turns and speed
bumps, and two streams that err together.
"""

MAX_LISTED_CONFLICTS: Final = 200
"""Conflicts of a reply at most, the latest; their number is exact."""

MAX_REVIEWERS: Final = 100
"""Reviewers of a reply at most, those with the most verdicts."""

FEW_ITEMS: Final = 10
"""Common items of two reviewers below which kappa is not shown: one more would turn it round."""

MAX_VERDICTS_ASKED: Final = 500
"""Rows of one page of the verdicts at most."""

MAX_CHOICES: Final = 1000
"""Values of one filter that a reply lists."""

Z_95: Final = 1.959963984540054
"""Quantile of the normal distribution for an interval of 95 %."""


class JudgeRequest(BaseModel):
    """Request to store a verdict; the same request again, by its key, is stored once."""

    model_config = _STRICT

    key: WriteKey = Field(description="Unique name of this write.")
    scene_id: SceneId
    sha256: Digest | None = Field(
        default=None, description="Digest of the record that was seen; null: the current one."
    )
    track_id: Tally | None = Field(default=None, description="Null: the scene.")
    reviewer: Name
    verdict: Verdict
    cause: Cause = ""
    note: Note = ""
    duplicate_of: SceneId | None = None
    took_s: Seconds | None = None


def key_of_content(*parts: str) -> str:
    """Return the key of an imported verdict from its content: a repeated import stores nothing."""
    digest = sha256("\n".join(parts).encode()).hexdigest()
    return f"labels-{digest[:32]}"


class UndoRequest(BaseModel):
    """Request to undo a reviewer's last verdict, of one scene or track or of all."""

    model_config = _STRICT

    key: WriteKey = Field(description="Unique name of this write.")
    reviewer: Name
    scene_id: SceneId | None = Field(default=None, description="Null: the last one of all.")
    track_id: Tally | None = Field(
        default=None, description="With a scene: its track; null: the verdict on the scene."
    )


class VerdictsRequest(BaseModel):
    """Request for a page of the verdicts, latest first."""

    model_config = _STRICT

    scene_id: SceneId | None = Field(default=None, description="Null: of all scenes.")
    reviewer: Name | None = Field(default=None, description="Null: of all reviewers.")
    current: bool = Field(default=True, description="Only those that count.")
    before: Count | None = Field(
        default=None, description="Only smaller numbers: `next` of the page before; null: all."
    )
    most: int = Field(default=100, ge=1, le=MAX_VERDICTS_ASKED)


class AgreementRequest(BaseModel):
    """Request for agreement, pace and precision, over all verdicts or those on a selection."""

    model_config = _STRICT

    selection: Name | None = Field(default=None, description="Only its scenes; null: all.")


class Pace(BaseModel):
    """Progress of one reviewer."""

    model_config = _STRICT

    reviewer: Name
    scenes: Count = Field(description="Scenes with a verdict of the reviewer on them or a track.")
    verdicts: Count = Field(description="Verdicts that count, on scenes and tracks.")
    median_s: Finite | None = Field(
        description="Median time of a verdict, seconds; null: none was measured."
    )


class PairAgreement(BaseModel):
    """Agreement of two reviewers on what both judged: scenes, and tracks, of the same record."""

    model_config = _STRICT

    one: Name
    other: Name
    items: Count = Field(description="Scenes and tracks that both judged.")
    agreed: Count = Field(description="Of these, with the same verdict.")
    kappa: Finite | None = Field(
        description="Cohen's kappa over six verdicts; null where chance alone explains all: no "
        "item, or one verdict throughout."
    )


class Conflict(BaseModel):
    """A scene or track on which two reviewers decided differently which stream is wrong."""

    model_config = _STRICT

    scene_id: SceneId
    sha256: Digest
    track_id: Tally | None = None
    verdicts: tuple[VerdictRow, ...] = Field(max_length=MAX_REVIEWERS)


class Precision(BaseModel):
    """Share of judged scenes on which the supervised stream is wrong.

    A verdict of supervised, self-supervised, both or neither decides. A scene counts as judged when
    any reviewer decided on it or on one of its tracks. It counts as right when any of these
    verdicts is supervised or both. Each record of a scene counts by itself.
    """

    model_config = _STRICT

    right: Count
    judged: Count
    share: Share | None = Field(description="Right over judged; null while nothing is judged.")
    low: Share | None = Field(description="Lower bound of the 95 % Wilson interval.")
    high: Share | None = Field(description="Upper bound of the 95 % Wilson interval.")


class AgreementReply(BaseModel):
    """Agreement, conflicts, pace and precision of the verdicts that count."""

    model_config = _STRICT

    budget: Count | None = Field(description="Scenes of the selection; null: none was named.")
    scenes: Count = Field(description="Scenes with a verdict on them or on a track.")
    pace: tuple[Pace, ...] = Field(max_length=MAX_REVIEWERS, description="Most verdicts first.")
    pairs: tuple[PairAgreement, ...] = Field(max_length=MAX_REVIEWERS**2)
    conflicts: tuple[Conflict, ...] = Field(
        max_length=MAX_LISTED_CONFLICTS, description="The latest ones."
    )
    conflicting: Count = Field(description="Number of conflicts.")
    precision: Precision


class ChoicesReply(BaseModel):
    """Values that filters and verdicts choose from."""

    model_config = _STRICT

    vehicles: tuple[Kept, ...] = Field(max_length=MAX_CHOICES)
    software_versions: tuple[Kept, ...] = Field(max_length=MAX_CHOICES)
    kinds: tuple[Kept, ...] = Field(max_length=MAX_CHOICES)
    class_names: tuple[Kept, ...] = Field(max_length=MAX_CHOICES)
    modes: tuple[Kept, ...] = Field(max_length=MAX_CHOICES, description="Supervised streams.")
    reviewers: tuple[Kept, ...] = Field(max_length=MAX_CHOICES)
    causes: tuple[Kept, ...] = Field(
        max_length=MAX_CHOICES, description="The taxonomy, then those of the setting `causes`."
    )
    bucket: Kept = Field(
        default="", description="URL of the logs, to open one elsewhere; empty before a listing."
    )


def need_cause(cause: str, own: Sequence[str]) -> None:
    """Check that a cause is empty, of the taxonomy, or of the user's own list.

    Raises:
        UsageError: If it is none of them; the message lists all.
    """
    if cause and cause not in CAUSES and cause not in own:
        known = ", ".join((*CAUSES, *own))
        raise UsageError(f"no cause {cause!r}: choose of {known}, or add it to the setting causes")


def standing_of(events: Iterable[tuple[int, Verdict]]) -> int | None:
    """Return the number of the verdict that counts, of one reviewer on one scene or track.

    A verdict replaces the one before it, and an undo restores that one.

    Args:
        events: Number and verdict of each event, in their order.
    """
    given: list[int] = []
    for ordinal, verdict in events:
        if verdict is not Verdict.WITHDRAWN:
            given.append(ordinal)
        elif given:
            given.pop()
    return given[-1] if given else None


def cohens_kappa(pairs: Sequence[tuple[Verdict, Verdict]]) -> float | None:
    """Return Cohen's kappa of two reviewers.

    It is (observed - expected agreement) / (1 - expected agreement). The expected agreement is that
    of two reviewers who draw by chance, each with the frequencies of their own verdicts.

    Args:
        pairs: Verdicts of both on the same item.

    Returns:
        1 for full agreement, 0 for that of chance; None without an item, and where both gave one
        and the same verdict throughout.
    """
    n = len(pairs)
    if n == 0:
        return None
    ones, others = Counter(one for one, _ in pairs), Counter(other for _, other in pairs)
    agreed = sum(one is other for one, other in pairs)
    chance = sum(ones[verdict] * others[verdict] for verdict in GIVEN)
    if chance == n * n:
        return None
    return (n * agreed - chance) / (n * n - chance)


def wilson(right: int, judged: int, *, z: float = Z_95) -> tuple[float, float] | None:
    """Return the Wilson score interval of a share, by default of 95 %; None without a trial."""
    if judged == 0:
        return None
    share, spread = right / judged, z * z / judged
    middle = (share + spread / 2) / (1 + spread)
    half = z * math.sqrt(share * (1 - share) / judged + spread / (4 * judged)) / (1 + spread)
    return max(0.0, middle - half), min(1.0, middle + half)


def precision_of(right: int, judged: int) -> Precision:
    """Return a precision with its interval."""
    bounds = wilson(right, judged)
    if bounds is None:
        return Precision(right=0, judged=0, share=None, low=None, high=None)
    return Precision(
        right=right, judged=judged, share=right / judged, low=bounds[0], high=bounds[1]
    )


def agreement(rows: Sequence[VerdictRow], *, budget: int | None) -> AgreementReply:
    """Sum up the verdicts that count.

    Args:
        rows: Verdicts that count, in the order of their numbers.
        budget: Scenes of the selection they are on; None: no selection was named.
    """
    by_reviewer: defaultdict[str, list[VerdictRow]] = defaultdict(list)
    by_item: defaultdict[tuple[str, str, int | None], dict[str, VerdictRow]] = defaultdict(dict)
    for row in rows:
        by_reviewer[row.reviewer].append(row)
        by_item[row.scene_id, row.sha256, row.track_id][row.reviewer] = row
    reviewers = sorted(by_reviewer, key=lambda name: (-len(by_reviewer[name]), name))
    reviewers = reviewers[:MAX_REVIEWERS]
    conflicts = [item for item, given in by_item.items() if _differ(given.values())]
    latest = sorted(
        conflicts, key=lambda item: max(row.ordinal for row in by_item[item].values()), reverse=True
    )
    judged, right = judged_and_right(rows)
    return AgreementReply(
        budget=budget,
        scenes=len({row.scene_id for row in rows}),
        pace=tuple(_pace(name, by_reviewer[name]) for name in reviewers),
        pairs=tuple(_pairs(reviewers, list(by_item.values()))),
        conflicts=tuple(
            Conflict(
                scene_id=item[0],
                sha256=item[1],
                track_id=item[2],
                verdicts=tuple(by_item[item].values())[:MAX_REVIEWERS],
            )
            for item in latest[:MAX_LISTED_CONFLICTS]
        ),
        conflicting=len(conflicts),
        precision=precision_of(len(right), len(judged)),
    )


def judged_and_right(
    rows: Iterable[VerdictRow],
) -> tuple[set[tuple[str, str]], set[tuple[str, str]]]:
    """Return the records that are judged, and of these the right ones, as in `Precision`."""
    decided = [row for row in rows if row.verdict in DECIDED]
    return (
        {(row.scene_id, row.sha256) for row in decided},
        {(row.scene_id, row.sha256) for row in decided if row.verdict in RIGHT},
    )


def _differ(given: Iterable[VerdictRow]) -> bool:
    return len({row.verdict for row in given} & DECIDED) > 1


def _pace(reviewer: str, rows: Sequence[VerdictRow]) -> Pace:
    took = [row.took_s for row in rows if row.took_s is not None]
    return Pace(
        reviewer=reviewer,
        scenes=len({row.scene_id for row in rows}),
        verdicts=len(rows),
        median_s=median(took) if took else None,
    )


def _pairs(
    reviewers: Sequence[str], items: Sequence[dict[str, VerdictRow]]
) -> Iterable[PairAgreement]:
    both: defaultdict[tuple[str, str], list[tuple[Verdict, Verdict]]] = defaultdict(list)
    for given in items:
        if len(given) > 1:
            for one, other in combinations(sorted(given), 2):
                both[one, other].append((given[one].verdict, given[other].verdict))
    for pair in combinations(sorted(reviewers), 2):
        verdicts = both[pair]
        yield PairAgreement(
            one=pair[0],
            other=pair[1],
            items=len(verdicts),
            agreed=sum(one is other for one, other in verdicts),
            kappa=cohens_kappa(verdicts),
        )
