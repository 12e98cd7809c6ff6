"""The witness alone, while the self-supervised stream is blind."""

from dataclasses import replace

import numpy as np

from schemas.contradiction import LabelledFrame, Scene
from schemas.labels import Blindness, FrameHealth, FrameLabels, MotionLabel
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, ranked_tracks
from workers.contradiction.agreement import compare
from workers.contradiction.instances import find_instances
from workers.contradiction.track_score import RankedTrack

STATIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.UNKNOWN
PATH = Thing((10.0, 5.0, 0.0), STATIC, UNKNOWN, velocity_m_per_s=(6.0, 0.0, 0.0), measured=False)


def _track(votes: float, *, blind: bool) -> RankedTrack:
    """Return the track of a thing that the witness alone labels dynamic."""
    scene = labelled_scene([PATH], frames=8)
    frames = tuple(_seen(frame, votes, blind=blind) for frame in scene.frames)
    scene = Scene(scene.scene_id, frames)
    (track,) = ranked_tracks(scene, find_instances(scene, class_names=CLASS_NAMES))
    return track


def _seen(frame: LabelledFrame, votes: float, *, blind: bool) -> LabelledFrame:
    n = len(frame.semantic.labels)
    health = FrameHealth(Blindness.NO_PAST, "0.1 s of earlier frames") if blind else FrameHealth()
    predictive = replace(frame.predictive, health=health)
    return replace(
        frame,
        predictive=predictive,
        agreements=compare(frame.semantic.labels, predictive.labels),
        witness=FrameLabels(
            np.full(n, MotionLabel.DYNAMIC, np.uint8), np.full(n, votes, np.float16)
        ),
    )


def test_the_witness_alone_weighs_its_looks_while_the_other_stream_is_blind() -> None:
    aware, blind = _track(0.4, blind=False), _track(0.4, blind=True)
    assert aware.features.blind_share == 0.0
    assert blind.features.blind_share == 1.0
    assert abs(blind.features.witness_votes - 0.4) < 0.01
    assert blind.gate < 0.45 < aware.gate
    assert blind.strength < 0.4 * aware.strength


def test_more_looks_weigh_more_in_a_blind_moment() -> None:
    assert _track(0.2, blind=True).strength < 0.6 * _track(0.5, blind=True).strength


def test_the_evidence_names_the_blind_moment() -> None:
    attribution = _track(0.3, blind=True).attribution
    assert attribution is not None
    told = (*attribution.supporting, *attribution.opposing)
    assert "blind self-supervised stream" in told
