"""How strong a track is: what a look at it is worth, as a product of what must all hold.

    strength = persistence x points x size x chance x poses, each in [0, 1]

- persistence  1 - exp(-seen x steady / 0.5 s): seen counts the frames of the track less a
  half, steady is the share of the frames of its span in which it contradicts. Errors flicker. What
  the other of the two onlookers sees in its stead, before, after and in between, counts by its
  points, and as far as little else contradicts there (`cross_stream_sightings.py`).
- points       1 - exp(-points / 25): median points per frame.
- size         0 above 30 m of length: a facade is no road user; and 0 where it is near, low and a
  tenth as high as long: nor are stretches of road, kerbs and rails.
- chance       that the supervised stream is wrong about it, alone or with the other
  (`attribution.py`): the witness's opinion, how far and how straight it went, whether the path
  bears out the measured speed, what was proved twice, whether it stands on its own, how sure both
  streams are, whether poses are doubted and much else contradicts alike.
- poses        the square of the mean weight of the poses of its frames: healthy 1, degraded 1/2,
  lost 0. A pose that is doubted while a thing is not seen says nothing against it, and little where
  hardly anything else contradicts: wrong poses make the whole street seem to move. Nor does a doubt
  count where the supervised stream alone sees motion: they do not make what moves seem to stand.

About anything but motion it was never measured who errs: there the last two are the product of both
streams' confidence, of the share of the surroundings that contradict alike and, where things are
asked about, of a box like a road user's.

A look is for the failures of the supervised stream: a track on which the other one errs is worth
next to nothing, however large. Every term is in the record, or follows from what is in it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution
from schemas.contradiction import Instance, Scene
from schemas.frame import OdometryState
from workers.contradiction.attribution import attribute, tables
from workers.contradiction.cross_stream_sightings import Company, company_of, frames_seen
from workers.contradiction.explanations import remarks_on
from workers.contradiction.feature_extraction import evidence_of
from workers.contradiction.scene_context import Surroundings, surroundings_of
from workers.contradiction.settings import DEFAULT_SCORE, ScoreSettings
from workers.contradiction.size_priors import box_plausibility, not_flat, not_too_long
from workers.contradiction.track_features import Evidence
from workers.contradiction.tracks import Track, tie_tracks
from workers.contradiction.unit import clip


@dataclass(frozen=True, slots=True, eq=False)
class RankedTrack:
    """A track with what the record says of it.

    Attributes:
        track: The track.
        strength: Product of the factors, rounded to 4 digits.
        presence: Of those that say how lasting and large it is: without chance and poses.
        gate: What doubted poses leave of it.
        strongest: Index of its instance with the most points and surest clash.
        speed_m_per_s: Median of the measured speeds over the ground; 0 when none was measured.
        class_name: Commonest class of its points.
        points: Over all its instances.
        confirmed_share: Of them; None where the self-supervised stream says static or does not
            tell.
        evidence: What is known about it, as named numbers.
        attribution: Who is probably wrong about it; None where that was never measured.
    """

    track: Track
    strength: float
    presence: float
    gate: float
    strongest: int
    speed_m_per_s: float
    class_name: str
    points: int
    evidence: Evidence
    attribution: Attribution | None
    confirmed_share: float | None = None


def rank_tracks(
    scene: Scene, instances: Sequence[Instance], *, settings: ScoreSettings = DEFAULT_SCORE
) -> tuple[RankedTrack, ...]:
    """Tie the instances of a scene to tracks, strongest first; equal ones by first instance."""
    if not instances:
        return ()
    around = surroundings_of(scene, instances)
    weights = pose_weights(scene, settings=settings)
    tracks = tie_tracks(scene, instances)
    company = company_of(scene, tracks, instances)
    ranked = [
        _rank(
            scene,
            track,
            [instances[i] for i in track.members],
            around,
            company,
            weights,
            settings,
        )
        for track in tracks
    ]
    ranked.sort(key=lambda each: (-each.strength, each.track.members[0]))
    return tuple(ranked)


def pose_weights(scene: Scene, *, settings: ScoreSettings = DEFAULT_SCORE) -> NDArray[np.float64]:
    """Say what counts of what is seen in each frame, by whether its pose may be trusted.

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
    """How lasting a track is, from the frames it was seen in and those of its span."""
    seen_s = (frames - 0.5) * period_s
    return 1.0 - math.exp(-seen_s * frames / span_frames / scale_s)


def motion_plausibility(
    centres_m: NDArray[np.float64],
    stamps_s: NDArray[np.float64],
    velocities_m_per_s: NDArray[np.float64],
    settings: ScoreSettings = DEFAULT_SCORE,
) -> float:
    """How well the path of a track bears out the velocity a stream measured.

    Args:
        centres_m: (F, 3) box centres, odom space.
        stamps_s: (F,) their times.
        velocities_m_per_s: (F, 3) measured, odom space; zero rows were not measured.
        settings: Tolerances.
    """
    measured = velocities_m_per_s[np.any(velocities_m_per_s != 0.0, axis=1)]
    if not len(measured):
        return settings.unmeasured
    velocity = np.median(measured, axis=0)
    speed = float(np.median(np.linalg.norm(measured, axis=1)))
    fast_enough = clip(speed / settings.slow_m_per_s)
    span_s = float(stamps_s[-1] - stamps_s[0])
    if span_s < 0.4:  # a box jumps by decimetres: too short a path says nothing
        return fast_enough * (1.0 + settings.unmeasured) / 2
    path = (centres_m[-1] - centres_m[0]) / span_s
    tolerance = settings.path_error_m_per_s + settings.path_error_share * speed
    error = float(np.linalg.norm((path - velocity)[:2])) / tolerance
    agrees = settings.implausible + (1.0 - settings.implausible) * math.exp(-(error**2))
    return fast_enough * agrees


def _rank(
    scene: Scene,
    track: Track,
    members: Sequence[Instance],
    around: Surroundings,
    company: Company,
    weights: NDArray[np.float64],
    settings: ScoreSettings,
) -> RankedTrack:
    points = np.array([len(member.point_index) for member in members])
    sure = np.array([m.semantic_confidence * m.predictive_confidence for m in members])
    velocities = np.stack([member.velocity_m_per_s for member in members])
    stamps_s = np.array(
        [(scene.frames[m.frame_index].stamp_ns - scene.start_ns) / NS_PER_S for m in members]
    )
    size_m = np.median([member.size_m for member in members], axis=0)
    fits = 0.0
    if track.kind.measured or track.kind.of_witness:
        fits = motion_plausibility(track.centres_m, stamps_s, velocities, settings)
    box = box_plausibility(size_m, settings)
    evidence = evidence_of(
        scene, track, members, around, road_user=box, speed_fits=fits, settings=settings
    )
    kind, attribution = track.kind.name, None
    if kind in tables():
        remarks = remarks_on(kind, evidence, size_m, of_witness=track.kind.of_witness)
        attribution = attribute(kind, evidence, remarks=remarks)
        range_m = float(np.average([np.hypot(*m.centre_m[:2]) for m in members], weights=points))
        size = not_too_long(size_m, settings) * not_flat(size_m, range_m, settings)
        chance = attribution.supervised_wrong
    else:
        clash = float(np.average(sure, weights=points))
        size, chance = (box if scene.task.of_things else 1.0), clash * evidence.own
    lone = 1.0 - evidence.crowded
    frames = [member.frame_index for member in members]
    lasting = _lasting(dict.fromkeys(frames, 1.0), around.period_s, settings)
    seen = _lasting(frames_seen(track, members, company), around.period_s, settings)
    lasting += lone * max(0.0, seen - lasting)
    presence = lasting * evidence.many_points * size
    gate = _gate(weights[frames], lone, stands=track.kind.semantic == scene.task.moving)
    confirmed_share = _confirmed_share(members, points)
    speeds = np.linalg.norm(velocities, axis=1)
    return RankedTrack(
        track=track,
        strength=round(min(presence * chance * gate, 0.9999), 4),
        presence=round(presence, 4),
        gate=round(gate, 4),
        strongest=track.members[int(np.argmax(np.round(points * sure, 6)))],
        speed_m_per_s=round(float(np.median(speeds[speeds > 0])), 2) if speeds.any() else 0.0,
        class_name=_commonest([member.class_name for member in members], points),
        points=int(points.sum()),
        confirmed_share=confirmed_share,
        evidence=evidence,
        attribution=attribution,
    )


def _lasting(counts: Mapping[int, float], period_s: float, settings: ScoreSettings) -> float:
    """How lasting what was seen in some frames is: by index, rising, and what each counts."""
    return persistence(
        frames=sum(counts.values()),
        span_frames=max(counts) - min(counts) + 1,
        period_s=period_s,
        scale_s=settings.persistence_s,
    )


def _gate(weights: NDArray[np.float64], lone: float, *, stands: bool) -> float:
    """What doubted poses leave of a track.

    Args:
        weights: Of the poses of its frames.
        lone: How little else contradicts alike there.
        stands: Whether the contradiction is that it stands; only a lost pose counts then.
    """
    if stands:
        return float(np.sign(weights).mean()) ** 2
    known, gate = float((weights > 0.0).mean()), float(weights.mean()) ** 2
    return gate + max(0.0, known**2 - gate) * lone**2


def _confirmed_share(members: Sequence[Instance], points: NDArray[np.int64]) -> float | None:
    shares = [member.confirmed_share for member in members]
    told = [
        (share, count) for share, count in zip(shares, points, strict=True) if share is not None
    ]
    if not told:
        return None
    return float(np.average([share for share, _ in told], weights=[count for _, count in told]))


def _commonest(names: Sequence[str], points: NDArray[np.int64]) -> str:
    weight: dict[str, int] = {}
    for name, count in zip(names, points, strict=True):
        weight[name] = weight.get(name, 0) + int(count)
    return min(weight, key=lambda name: (-weight[name], name))
