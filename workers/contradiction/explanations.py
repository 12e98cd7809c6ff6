"""Explanations of an attribution: noun phrases for the features that a reviewer can check."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.contradiction.track_features import TrackFeatures

FAR: Final = 0.55
"""Feature `distance` at 44 m, where a person returns 20 points."""

FEW: Final = 0.4
TURNING: Final = 0.5
HALF: Final = 0.5
SURE: Final = 0.7
LITTLE: Final = 0.2

TYPICAL_OF_KIND: Final[Mapping[str, str]] = {
    "only_semantic_dynamic": "typical of supervised-only tracks",
    "only_predictive_dynamic": "typical of self-supervised-only tracks",
    "only_witness_dynamic": "typical of witness-only tracks",
}
"""Explanation where no other one supports the attribution: the prior of its kind."""

MOST_PROBABLE: Final = "most probable of four attributions"
"""Explanation where the prior of the kind opposes the attribution too."""

EXPLANATION_TEXTS: Final[Mapping[str, str]] = {
    "witness label dynamic": "free space before and after shows that most of it moves",
    "witness label static": "free space before and after shows that most of it is static",
    "agreed dynamic earlier": "both streams label it dynamic for a third of a second, in the first "
    "half of its track or up to a second before",
    "not refuted later": "for a third of a second, the supervised stream labels it dynamic and the "
    "other stream does not label it static; in the second half of its track or up to a second "
    "after",
    "supervised label dynamic earlier": "the supervised stream itself labels it dynamic earlier: "
    "its label changes",
    "supervised label dynamic later": "the supervised stream itself labels it dynamic later: its "
    "label changes",
    "static shape": "its shape is in the same place 0.5 to 2 s earlier and later",
    "static shape later": "its shape is in the same place 0.5 to 2 s later",
    "arrival from elsewhere": "its shape was elsewhere 0.5 to 2 s earlier; one velocity leads from "
    "there to here",
    "departure from its place": "its shape is elsewhere 0.5 to 2 s later; one velocity leads from "
    "here to there",
    "end of the log": "the log ends within 0.75 s of its first frame, so setting off cannot be "
    "observed",
    "atypical size": "it is too low, too long or too tall for a usual road user",
    "occlusion before and after": "the witness could not observe its place before or after",
    "blind self-supervised stream": "the self-supervised stream is blind in most of its frames: "
    "start of a log, gap, lost pose; the witness labels alone, by fewer looks",
    "motion in bulk": "more than 1,250 points per frame move by confirmed and measured motion",
    "flash of the label": "the supervised stream alone labels it dynamic, for less than about 0.4 "
    "s: too short for a failure",
    "unhealthy odometry": "poses were doubted in some of its frames",
    "rising ground around it": "the ground around it rises where no object is: spray, vibration",
    "clutter of like contradictions": "six or more others contradict in the same way in its frames",
    "long range": "it is beyond 44 m",
    "few points": "it has fewer than about 13 points per frame",
    "turning sensor": "the sensor turned at 0.15 rad/s or more",
    "low height": "it is near and lower than 0.75 m",
    "narrow box": "its box is narrower than 0.4 m",
    "slow motion": "it lasts, and its displacement is between 0.25 and 1 m",
    "intermittent contradiction": "it contradicts in less than 80 % of the frames of its span",
    "straight displacement": "it travels more than a metre along a straight path",
    "no displacement": "the boxes of its track stay within 0.25 m",
    "road-user size": "its box has the size of a road user",
    "size unlike a road user": "its box does not have the size of a road user",
    "isolated object": "most compared points in and around it contradict",
    "part of a larger object": "few compared points in and around it contradict",
    "rim of an agreed mover": "both streams label most of the dynamic points around it dynamic",
    "full contradiction": "the other stream labels most of the dynamic points around it static",
    "motion confirmed at most once": "the self-supervised stream confirmed its motion at most once",
    **dict.fromkeys(
        TYPICAL_OF_KIND.values(), "no feature supports the attribution, but the kind of track does"
    ),
    MOST_PROBABLE: "nothing supports the attribution, and the three others are less probable",
}
"""Every explanation of an attribution, with its meaning."""

MISSED: Final = frozenset({"only_predictive_dynamic", "only_witness_dynamic"})
"""Kinds in which the supervised stream labels static what another source labels dynamic."""

GROUND_LOSS_M: Final = 0.3
"""Height lost to ground removal, metres."""

SHAPES: Final = (
    (1.3, 1.3, 0.9, 2.2),
    (2.7, 1.3, 0.9, 2.2),
    (6.5, 2.6, 1.0, 3.2),
    (19.0, 3.2, 2.0, 4.6),
)
"""Largest length and width, smallest and largest height, metres, of people, two-wheelers, cars and
vans, trucks and buses. Length and width have no lower bound, since a lidar often sees one side."""


def is_atypical_size(size_m: NDArray[np.float64]) -> bool:
    """Return whether a box is too low, too long or too tall for any class of road user.

    Args:
        size_m: (3,) length, width and height of the observed box.
    """
    length_m, width_m, height_m = (float(side) for side in size_m)
    return not any(
        length_m <= longest and width_m <= widest and least - GROUND_LOSS_M <= height_m <= most
        for longest, widest, least, most in SHAPES
    )


@dataclass(frozen=True, slots=True)
class Explanation:
    """A noun phrase about a track, with the features that it rests on.

    Attributes:
        words: The phrase, a key of `EXPLANATION_TEXTS`.
        counterfactual: These features as they would be without it; empty where the tables of
            `attribution.py` do not use them.
        quiet: Reported only where no other explanation supports the attribution.
    """

    words: str
    counterfactual: Mapping[str, float]
    quiet: bool = False


def explanations_of(
    kind: str, features: TrackFeatures, size_m: NDArray[np.float64], *, of_witness: bool
) -> tuple[Explanation, ...]:
    """Return the explanations that hold for a track, before they are weighed.

    Args:
        kind: Name of the kind of contradiction.
        features: Features of the track.
        size_m: (3,) median length, width and height of its box.
        of_witness: Whether the kind itself states that the witness labels it dynamic.
    """
    unlabelled = 1.0 - features.witness_dynamic - features.witness_static
    # The shape of a part, or of a poorly observed object, is no evidence of its class.
    whole = features.isolation > SURE and features.point_count > HALF and features.distance < FAR
    missed = kind in MISSED and features.supervised_confidence > SURE and whole
    slow = HALF > features.displacement > 0.2 and features.duration > HALF
    dynamic = features.witness_dynamic > HALF and not of_witness
    before, after = features.agreed_before > HALF, features.not_refuted_after > HALF
    dynamic_before = kind in MISSED and not before and features.dynamic_before > HALF
    dynamic_after = kind in MISSED and not after and features.dynamic_after > HALF
    static, static_after = features.shape_static > HALF, features.shape_static_after > HALF
    candidates: tuple[tuple[str, bool, Mapping[str, float]], ...] = (
        ("witness label dynamic", dynamic, {"witness_dynamic": 0.0}),
        ("witness label static", features.witness_static > HALF, {"witness_static": 0.0}),
        ("agreed dynamic earlier", before, {"agreed_before": 0.0}),
        ("not refuted later", after, {"not_refuted_after": 0.0}),
        ("supervised label dynamic earlier", dynamic_before, {"dynamic_before": 0.0}),
        ("supervised label dynamic later", dynamic_after, {"dynamic_after": 0.0}),
        ("static shape", static, {"shape_static": 0.0, "shape_static_after": 0.0}),
        ("static shape later", static_after and not static, {"shape_static_after": 0.0}),
        ("arrival from elsewhere", features.arrived > HALF, {"arrived": 0.0, "transits": 0.0}),
        ("departure from its place", features.departed > HALF, {"departed": 0.0, "transits": 0.0}),
        ("end of the log", features.log_end > HALF, {"log_end": 0.0}),
        ("atypical size", missed and is_atypical_size(size_m), {}),
        ("occlusion before and after", unlabelled > HALF, {}),
        ("blind self-supervised stream", features.blind_share > HALF, {"blind_share": 0.0}),
        ("motion in bulk", features.bulk_motion > HALF, {"bulk_motion": 0.0}),
        ("flash of the label", features.label_time < HALF, {}),
        ("unhealthy odometry", features.pose_doubted > 0.0, {"pose_doubted": 0.0}),
        ("rising ground around it", features.rising_ground > HALF, {"rising_ground": 0.0}),
        ("clutter of like contradictions", features.clutter > HALF, {"clutter": 0.0}),
        ("long range", features.distance > FAR, {"distance": 0.0}),
        ("few points", features.point_count < FEW, {"point_count": 1.0}),
        ("turning sensor", features.turn_rate > TURNING, {"turn_rate": 0.0}),
        ("low height", features.lowness > HALF, {"lowness": 0.0}),
        ("narrow box", features.thinness > 0.0, {"thinness": 0.0}),
        ("slow motion", slow, {"displacement": 0.0}),
        ("intermittent contradiction", features.continuity < 0.8, {"continuity": 1.0}),
    )
    loud = tuple(Explanation(words, without) for words, holds, without in candidates if holds)
    return loud + _quiet(features)


def _quiet(features: TrackFeatures) -> tuple[Explanation, ...]:
    """Return explanations by path, size and isolation: weighty, but visible in any picture."""
    travels = features.displacement > HALF and features.straightness > HALF
    rests = features.displacement < LITTLE
    candidates: tuple[tuple[str, bool, Mapping[str, float]], ...] = (
        ("straight displacement", travels, {"displacement": 0.0, "straightness": 0.0}),
        ("no displacement", rests, {"displacement": 1.0, "straightness": 1.0}),
        ("road-user size", features.road_user_size > SURE, {"road_user_size": 0.0}),
        ("size unlike a road user", features.road_user_size < LITTLE, {"road_user_size": 1.0}),
        ("isolated object", features.isolation > SURE, {"isolation": 0.0}),
        ("part of a larger object", features.isolation < LITTLE, {"isolation": 1.0}),
        ("rim of an agreed mover", features.agreed_share > HALF, {"agreed_share": 0.0}),
        ("full contradiction", features.denied_share > SURE, {"denied_share": 0.0}),
        ("motion confirmed at most once", features.confirmed < LITTLE, {"confirmed": 1.0}),
    )
    return tuple(
        Explanation(words, without, quiet=True) for words, holds, without in candidates if holds
    )
