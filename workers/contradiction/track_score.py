"""Strength of a track: the expected value of reviewing it, as a product of six factors.

    strength = persistence x points x size x chance x poses x looks, each in [0, 1]

- persistence  1 - exp(-seen x continuity / 0.5 s). `seen` is the number of frames of the track less
  a half, times the frame period; `continuity` is the share of the frames of its span in which it
  contradicts. Errors flicker. Sightings by the other motion source add frames, by their points and
  less in clutter (`cross_stream_sightings.py`). Where the supervised stream alone labels dynamic,
  the time of its label counts too: half a second makes a failure (`flashes.py`).
- points       1 - exp(-points / 25), for the median points per frame.
- size         0 above 30 m of length, since a facade is no road user. It is also 0 for a near and
  flat box: a stretch of road, a kerb, a rail.
- chance       Probability that the supervised stream is wrong, alone or with the other stream
  (`attribution.py`).
- poses        Square of the mean weight of the poses of its frames: healthy 1, degraded 1/2, lost
  0. It applies less to an isolated contradiction, because wrong poses make the whole street appear
  to move. Tracks that only the supervised stream labels dynamic lose by lost poses alone, because
  wrong poses never make a mover appear static.
- looks        Where the self-supervised stream is blind and the witness labels alone, the share of
  the frames of a full second before and after that vote (`blind_moments.py`); else 1.

Attribution was fitted for motion only. For other tasks `chance` is the product of both streams'
confidences and of the isolation of the track. `size` is then the plausibility of its box where the
task is about objects, else 1.

A review looks for failures of the supervised stream: a track on which the other stream is wrong has
a strength near 0, however large it is. Every factor is in the record or follows from it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.attribution import Attribution
from schemas.contradiction import Instance, Scene
from schemas.frame import OdometryState
from workers.contradiction.cross_stream_sightings import (
    CrossStreamSightings,
    frames_seen,
    sightings_of,
)
from workers.contradiction.score_settings import DEFAULT_SCORE, ScoreSettings
from workers.contradiction.size_priors import box_plausibility, not_flat, not_too_long
from workers.contradiction.track_features import DescribedTrack, TrackFeatures
from workers.contradiction.tracks import Track, frame_period_s


@dataclass(frozen=True, slots=True, eq=False)
class RankedTrack:
    """A ranked track with the data of its record.

    Attributes:
        track: The track.
        strength: Product of the six factors, rounded to 4 digits.
        presence: Product of persistence, points and size.
        gate: Product of the factors of doubted poses and of looks.
        strongest: Index of its instance with the most points and the highest confidences.
        speed_m_per_s: Median of the measured speeds over the ground; 0 when none was measured.
        class_name: Commonest class of its points.
        points: Over all its instances.
        features: Its features.
        attribution: Attribution to the streams; None for a kind that no table was fitted for.
        confirmed_share: Share of its points with confirmed motion; None where the self-supervised
            stream labels it static or does not report it.
    """

    track: Track
    strength: float
    presence: float
    gate: float
    strongest: int
    speed_m_per_s: float
    class_name: str
    points: int
    features: TrackFeatures
    attribution: Attribution | None
    confirmed_share: float | None = None


def rank_tracks(
    scene: Scene,
    described: Sequence[DescribedTrack],
    attributions: Sequence[Attribution | None],
    *,
    settings: ScoreSettings = DEFAULT_SCORE,
) -> tuple[RankedTrack, ...]:
    """Rank the tracks of a scene by strength; ties by their first instance.

    Args:
        scene: The scene.
        described: Its tracks with their features.
        attributions: Their attributions, in the same order.
        settings: Constants of the score.
    """
    weights = pose_weights(scene, settings=settings)
    sightings = sightings_of(scene, described)
    ranked = [
        _rank(scene, each, attribution, sightings, weights, settings)
        for each, attribution in zip(described, attributions, strict=True)
    ]
    ranked.sort(key=lambda each: (-each.strength, each.track.members[0]))
    return tuple(ranked)


def pose_weights(scene: Scene, *, settings: ScoreSettings = DEFAULT_SCORE) -> NDArray[np.float64]:
    """Return the weight of each frame, by the health of its pose.

    Returns:
        (F,) weights, 0 to 1.
    """
    weight_of = {
        OdometryState.HEALTHY: 1.0,
        OdometryState.DEGRADED: settings.degraded_weight,
        OdometryState.LOST: 0.0,
    }
    return np.array([weight_of[frame.posed.odometry] for frame in scene.frames])


def persistence(*, frames: float, span_frames: int, period_s: float, scale_s: float) -> float:
    """Return the persistence of a track, 0 to 1, from its frames and the frames of its span."""
    seen_s = (frames - 0.5) * period_s
    return 1.0 - math.exp(-seen_s * frames / span_frames / scale_s)


def _rank(
    scene: Scene,
    described: DescribedTrack,
    attribution: Attribution | None,
    sightings: CrossStreamSightings,
    weights: NDArray[np.float64],
    settings: ScoreSettings,
) -> RankedTrack:
    track, members, features = described.track, described.members, described.features
    points, size_m = described.points, described.size_m
    sure = np.array([m.semantic_confidence * m.predictive_confidence for m in members])
    if attribution is not None:
        range_m = float(np.average([np.hypot(*m.centre_m[:2]) for m in members], weights=points))
        size = not_too_long(size_m, settings) * not_flat(size_m, range_m, settings)
        chance = attribution.supervised_wrong
    else:
        clash = float(np.average(sure, weights=points))
        size = box_plausibility(size_m, settings) if scene.task.of_things else 1.0
        chance = clash * features.isolation
    lone = 1.0 - features.clutter
    period_s = frame_period_s(scene)
    frames = [member.frame_index for member in members]
    lasting = _lasting(dict.fromkeys(frames, 1.0), period_s, settings)
    seen = _lasting(frames_seen(track, members, sightings), period_s, settings)
    lasting += lone * max(0.0, seen - lasting)
    presence = lasting * features.label_time * features.point_count * size
    gate = _gate(weights[frames], lone, static=track.kind.semantic == scene.task.moving)
    gate *= 1.0 - features.blind_share * (1.0 - features.witness_votes)
    speeds = np.linalg.norm(np.stack([member.velocity_m_per_s for member in members]), axis=1)
    return RankedTrack(
        track=track,
        strength=round(min(presence * chance * gate, 0.9999), 4),
        presence=round(presence, 4),
        gate=round(gate, 4),
        strongest=track.members[int(np.argmax(np.round(points * sure, 6)))],
        speed_m_per_s=round(float(np.median(speeds[speeds > 0])), 2) if speeds.any() else 0.0,
        class_name=_commonest([member.class_name for member in members], points),
        points=int(points.sum()),
        confirmed_share=_confirmed_share(members, points),
        features=features,
        attribution=attribution,
    )


def _lasting(counts: Mapping[int, float], period_s: float, settings: ScoreSettings) -> float:
    """Return the persistence of weighted frames, given by ascending index."""
    return persistence(
        frames=sum(counts.values()),
        span_frames=max(counts) - min(counts) + 1,
        period_s=period_s,
        scale_s=settings.persistence_s,
    )


def _gate(weights: NDArray[np.float64], lone: float, *, static: bool) -> float:
    """Return the factor of doubted poses on a track.

    Args:
        weights: Of the poses of its frames.
        lone: One minus its clutter, which counts others that contradict in the same way.
        static: Whether the other source labels the track static; then only lost poses count.
    """
    if static:
        return float(np.sign(weights).mean()) ** 2
    known, gate = float((weights > 0.0).mean()), float(weights.mean()) ** 2
    return gate + max(0.0, known**2 - gate) * lone**2


def _confirmed_share(members: Sequence[Instance], points: NDArray[np.int64]) -> float | None:
    shares = [member.confirmed_share for member in members]
    reported = [
        (share, count) for share, count in zip(shares, points, strict=True) if share is not None
    ]
    if not reported:
        return None
    return float(
        np.average([share for share, _ in reported], weights=[count for _, count in reported])
    )


def _commonest(names: Sequence[str], points: NDArray[np.int64]) -> str:
    weight: dict[str, int] = {}
    for name, count in zip(names, points, strict=True):
        weight[name] = weight.get(name, 0) + int(count)
    return min(weight, key=lambda name: (-weight[name], name))
