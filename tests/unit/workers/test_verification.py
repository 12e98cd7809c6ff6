from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.free_space import FREE, FREE_IF_TALL, HIDDEN, count_votes
from workers.lidar.beam_table import BeamTable
from workers.points.clusters import from_labels
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.registration import RegistrationResiduals
from workers.selfsupervised.verification import verify_motions


def block(x: float, height_m: float) -> NDArray[np.float32]:
    """A side two metres long, in steps of a tenth."""
    along, up = np.meshgrid(np.arange(0.0, 2.0, 0.1), np.arange(0.0, height_m, 0.1))
    points = np.stack([x + along, np.full_like(along, 6.0), up], axis=-1).reshape(-1, 3)
    placed: NDArray[np.float32] = points.astype(np.float32)
    return placed


def unregistered(count: int) -> RegistrationResiduals:
    nothing, shift = np.full(count, 9.0, np.float32), np.zeros((count, 3), np.float32)
    return RegistrationResiduals(
        tried=np.zeros(count, np.bool_),
        extent_m=np.full(count, 2.0, np.float32),
        still_energy_far=nothing,
        still_energy_near=nothing,
        energy_far=nothing,
        energy_near=nothing,
        shift_far_m=shift,
        shift_near_m=shift,
        energy_between=nothing,
    )


@pytest.mark.parametrize(
    ("answer", "moves"),
    [(FREE, [True, True]), (FREE_IF_TALL, [False, True]), (HIDDEN, [False, False])],
)
def test_what_one_beam_sees_may_have_been_between_two_that_are_far_apart(
    answer: int, moves: list[bool]
) -> None:
    flat, tall = block(0.0, 0.1), block(10.0, 1.0)
    points_m = np.concatenate([flat, tall])
    labels = np.repeat([0, 1], [len(flat), len(tall)]).astype(np.int32)
    answers = np.full(len(points_m), answer, np.int8)
    evidence = FreeSpaceEvidence(
        votes=count_votes([answers] * 3, len(points_m)),
        after=count_votes([], len(points_m)),
        near=answers,
        far=answers,
        image=np.zeros((2, 1800), np.float32),
        table=BeamTable(np.array([-0.1, 0.1], np.float32), np.zeros(3), 0.03),
        sensor_height_m=1.8,
        beams_from_odom=np.eye(4),
    )
    motions = verify_motions(
        points_m, from_labels(labels), unregistered(2), evidence, near_age_s=0.1, far_age_s=0.5
    )
    assert motions.seen_through.tolist() == moves


def test_what_leaves_its_place_afterwards_moves_now() -> None:
    """Hidden before, it would say nothing of itself."""
    tall = block(10.0, 1.0)
    free, hidden = (np.full(len(tall), answer, np.int8) for answer in (FREE, HIDDEN))
    evidence = FreeSpaceEvidence(
        votes=count_votes([hidden] * 3, len(tall)),
        after=count_votes([free] * 3, len(tall)),
        near=hidden,
        far=hidden,
        image=np.zeros((2, 1800), np.float32),
        table=BeamTable(np.array([-0.1, 0.1], np.float32), np.zeros(3), 0.03),
        sensor_height_m=1.8,
        beams_from_odom=np.eye(4),
    )
    clusters, fit = from_labels(np.zeros(len(tall), np.int32)), unregistered(1)
    ages = {"near_age_s": 0.1, "far_age_s": 0.5}
    assert verify_motions(tall, clusters, fit, evidence, **ages).seen_through.tolist() == [True]
    before = replace(evidence, after=count_votes([], len(tall)))
    assert verify_motions(tall, clusters, fit, before, **ages).seen_through.tolist() == [False]
