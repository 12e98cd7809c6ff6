"""Rescoring: the record of a scene, computed again from its scoring inputs alone."""

from schemas.score import SceneScore
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.score import record_of
from workers.contradiction.scoring_inputs import ScoringInputs
from workers.contradiction.track_score import RankedTrack, rank_tracks


def rescored(inputs: ScoringInputs) -> SceneScore:
    """Compute the record of a scene again, as mining does from its tracks on.

    The same program gives the same record. Another table of attributions, or another formula of the
    strength, gives the record that mining would give, without the log.
    """
    return rescored_tracks(inputs)[0]


def rescored_tracks(inputs: ScoringInputs) -> tuple[SceneScore, tuple[RankedTrack, ...]]:
    """Compute the record of a scene again, with its ranked tracks."""
    attributions = attribute_tracks(inputs.tracks, taught=inputs.producers.taught)
    ranked = rank_tracks(inputs.scene, inputs.tracks, attributions)
    record = record_of(
        *(inputs.origin, inputs.scene, inputs.statistics, inputs.instances, ranked),
        producers=inputs.producers,
        own_model=inputs.own_model,
    )
    return record, ranked
