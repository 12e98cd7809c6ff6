"""What is known of a track, in words: where, how, and what the witness saw."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.track_features import Evidence

FAR: Final = 0.55
"""44 m: a person is 20 points there."""

FEW: Final = 0.4
TURNING: Final = 0.5
HALF: Final = 0.5
SURE: Final = 0.7

LITTLE: Final = 0.2

AS_MOST: Final[Mapping[str, str]] = {
    "only_semantic_dynamic": "as most that the supervised stream alone sees move",
    "only_predictive_dynamic": "as most that the self-supervised stream alone sees move",
    "only_witness_dynamic": "as most that the witness alone sees move",
}
"""What speaks for an answer where nothing that is told does: the kind of contradiction."""

LIKELIEST: Final = "the likeliest of four"
"""What is left where the kind speaks against it, too."""

TOLD: Final[Mapping[str, str]] = {
    "the witness sees it move": "free space before and after says that most of it moves",
    "the witness sees it stand": "free space before and after says that most of it stands",
    "both see it move before": "in its first half or up to a second before, for a third of a "
    "second, both streams call it moving",
    "nobody denies later that it moves": "in its second half or up to a second after, for a third "
    "of a second, the supervised stream calls it moving and the other one not static",
    "called moving before": "the supervised stream itself calls it moving then: its answer changes",
    "called moving later": "the supervised stream itself calls it moving later: its answer changes",
    "it stays where it is": "its shape lies where points lie half a second to two seconds before, "
    "and later",
    "it came from elsewhere": "half a second to two seconds before, its shape lay elsewhere: one "
    "velocity leads from there to here",
    "it leaves its place": "half a second to two seconds later, its shape lies elsewhere: one "
    "velocity leads from here to there",
    "it stands later": "half a second to two seconds later, its shape lies where it does now",
    "the log ends right after": "within 0.75 s of its beginning: whether it sets off is not seen",
    "its shape fits no usual class": "too low, too long or too tall for a usual road user",
    "occluded before and after": "the witness could not see its place before or after",
    "odometry unhealthy": "poses were doubted in some of its frames",
    "the ground rises around it": "the ground around it rises where nothing stands: spray, shaking",
    "much else contradicts alike": "six others and more contradict in the same way in its frames",
    "far": "beyond 44 m",
    "few points": "under about 13 points a frame",
    "at a turn": "while the sensor turned by 0.15 rad/s and more",
    "low": "under 0.75 m high, near",
    "thin": "under 0.4 m wide",
    "slow": "it lasts, and goes between a quarter of a metre and one metre",
    "flickers": "it contradicts in less than 80 % of the frames of its span",
    "it goes its way": "it goes over a metre along a straight path",
    "its boxes go nowhere": "the boxes of its track stay within a quarter of a metre",
    "of a road user's size": "its box has the size of a road user",
    "of no road user's size": "its box has no road user's size",
    "a thing of its own": "what contradicts is most of what is compared in and around it",
    "a part of something": "little of what is compared in and around it contradicts",
    "the rim of what both see move": "most that is called moving around it both call moving",
    "the other calls all of it standing": "most that is called moving around it the other stream "
    "calls standing",
    "never proved twice to move": "the self-supervised stream proved once at most that it moves",
    **dict.fromkeys(AS_MOST.values(), "no evidence speaks for the verdict, but the kind does"),
    LIKELIEST: "nothing speaks for the verdict, and the three others are less likely",
}
"""What may be told of a track for, against or beside a verdict, and what that means."""

MISSED: Final = frozenset({"only_predictive_dynamic", "only_witness_dynamic"})
"""Kinds in which the supervised stream calls static what is seen to move."""

TAKEN_M: Final = 0.3
"""What may be missing of a height: it went with the ground."""

SHAPES: Final = (
    (1.3, 1.3, 0.9, 2.2),
    (2.7, 1.3, 0.9, 2.2),
    (6.5, 2.6, 1.0, 3.2),
    (19.0, 3.2, 2.0, 4.6),
)
"""People, two-wheelers, cars and vans, trucks and buses: the most length and width, the least and
the most height, metres. Of length and width a lidar sees one side or less: they bound from above
alone."""


def fits_no_class(size_m: NDArray[np.float64]) -> bool:
    """Whether a box is too low, too long or too tall for any road user that networks know.

    Args:
        size_m: (3,) length, width and height of what was seen.
    """
    length_m, width_m, height_m = (float(side) for side in size_m)
    return not any(
        length_m <= longest and width_m <= widest and least - TAKEN_M <= height_m <= most
        for longest, widest, least, most in SHAPES
    )


@dataclass(frozen=True, slots=True)
class Remark:
    """Something worth saying of a track.

    Attributes:
        words: What is said.
        otherwise: The evidence it rests on, as it would be were it not so; empty where the tables
            of `attribution.py` do not ask for it.
        quiet: Told only where nothing else speaks for the answer.
    """

    words: str
    otherwise: Mapping[str, float]
    quiet: bool = False


def remarks_on(
    kind: str, evidence: Evidence, size_m: NDArray[np.float64], *, of_witness: bool
) -> tuple[Remark, ...]:
    """Say what is known of a track that a person would want to hear.

    Args:
        kind: Name of the kind of contradiction.
        evidence: What is known about the track.
        size_m: (3,) length, width and height of its box in the median.
        of_witness: Whether the kind says already that the witness sees it move.
    """
    unasked = 1.0 - evidence.witness_moving - evidence.witness_still
    # a piece of a thing, or one seen badly, has no shape of its own
    whole = evidence.own > SURE and evidence.many_points > HALF and evidence.far < FAR
    missed = kind in MISSED and evidence.supervised_sure > SURE and whole
    slow = HALF > evidence.went > 0.2 and evidence.lasting > HALF
    sees_move = evidence.witness_moving > HALF and not of_witness
    before, after = evidence.agreed_before > HALF, evidence.undenied_after > HALF
    called_before = kind in MISSED and not before and evidence.called_before > HALF
    called_after = kind in MISSED and not after and evidence.called_after > HALF
    stays, stands_after = evidence.stays > HALF, evidence.stands_after > HALF
    said: tuple[tuple[str, bool, Mapping[str, float]], ...] = (
        ("the witness sees it move", sees_move, {"witness_moving": 0.0}),
        ("the witness sees it stand", evidence.witness_still > HALF, {"witness_still": 0.0}),
        ("both see it move before", before, {"agreed_before": 0.0}),
        ("nobody denies later that it moves", after, {"undenied_after": 0.0}),
        ("called moving before", called_before, {"called_before": 0.0}),
        ("called moving later", called_after, {"called_after": 0.0}),
        ("it stays where it is", stays, {"stays": 0.0, "stands_after": 0.0}),
        ("it stands later", stands_after and not stays, {"stands_after": 0.0}),
        ("it came from elsewhere", evidence.came > HALF, {"came": 0.0, "passes": 0.0}),
        ("it leaves its place", evidence.leaves > HALF, {"leaves": 0.0, "passes": 0.0}),
        ("the log ends right after", evidence.log_ends > HALF, {"log_ends": 0.0}),
        ("its shape fits no usual class", missed and fits_no_class(size_m), {}),
        ("occluded before and after", unasked > HALF, {}),
        ("odometry unhealthy", evidence.doubted > 0.0, {"doubted": 0.0}),
        ("the ground rises around it", evidence.ground_rises > HALF, {"ground_rises": 0.0}),
        ("much else contradicts alike", evidence.crowded > HALF, {"crowded": 0.0}),
        ("far", evidence.far > FAR, {"far": 0.0}),
        ("few points", evidence.many_points < FEW, {"many_points": 1.0}),
        ("at a turn", evidence.turning > TURNING, {"turning": 0.0}),
        ("low", evidence.low > HALF, {"low": 0.0}),
        ("thin", evidence.thin > 0.0, {"thin": 0.0}),
        ("slow", slow, {"went": 0.0}),
        ("flickers", evidence.steady < 0.8, {"steady": 1.0}),
    )
    loud = tuple(Remark(words, otherwise) for words, holds, otherwise in said if holds)
    return loud + _quiet(evidence)


def _quiet(evidence: Evidence) -> tuple[Remark, ...]:
    """What the chances rest on most and a picture shows: how it goes, how large and how alone."""
    goes = evidence.went > HALF and evidence.straight > HALF
    said: tuple[tuple[str, bool, Mapping[str, float]], ...] = (
        ("it goes its way", goes, {"went": 0.0, "straight": 0.0}),
        ("its boxes go nowhere", evidence.went < LITTLE, {"went": 1.0, "straight": 1.0}),
        ("of a road user's size", evidence.road_user > SURE, {"road_user": 0.0}),
        ("of no road user's size", evidence.road_user < LITTLE, {"road_user": 1.0}),
        ("a thing of its own", evidence.own > SURE, {"own": 0.0}),
        ("a part of something", evidence.own < LITTLE, {"own": 1.0}),
        ("the rim of what both see move", evidence.agreed > HALF, {"agreed": 0.0}),
        ("the other calls all of it standing", evidence.denied > SURE, {"denied": 0.0}),
        ("never proved twice to move", evidence.confirmed < LITTLE, {"confirmed": 1.0}),
    )
    return tuple(Remark(words, otherwise, quiet=True) for words, holds, otherwise in said if holds)
