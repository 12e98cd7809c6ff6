from dataclasses import replace

import numpy as np
import pytest

from schemas.frame import PosedFrame
from schemas.mining import MiningSettings
from tests.factories import SMALL_LIDAR, frame, posed
from workers.lab.evaluation.failures.uncertainty import ProbedStream, Probing
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.supervised.stream import SHIPPED, RangeImageStream

SETTINGS = MiningSettings(bucket="b", artifacts="memory://")


@pytest.fixture(scope="module")
def frames() -> list[PosedFrame]:
    street = build_street(4, seconds=1.0, style="stands")
    lidar = replace(SMALL_LIDAR, columns=256)
    return [
        posed(frame(sweep(street, lidar, index).points_m, at_s=0.1 * index)) for index in range(3)
    ]


def test_a_probed_stream_says_what_the_stream_says(frames: list[PosedFrame]) -> None:
    probed = ProbedStream.of(SETTINGS, Probing(dropout_every=2))
    assert probed is not None
    plain = RangeImageStream.salsanext_lmnet(SHIPPED)
    assert probed.version == plain.version
    for number, (mine, theirs) in enumerate(zip(probed(frames), plain(frames), strict=True)):
        np.testing.assert_array_equal(mine.labels, theirs.labels)
        np.testing.assert_array_equal(mine.confidence, theirs.confidence)
        told = probed.take(frames[number].frame.stamp_ns)
        asked = {"mc_dropout"} if number % 2 == 0 else set()
        assert set(told) == {"entropy", "margin"} | asked
        for values in told.values():
            assert values.shape == mine.labels.shape
            inside = values[np.isfinite(values)]
            assert inside.size
            assert (inside >= 0.0).all()
            assert (inside <= 1.0).all()
        assert probed.take(frames[number].frame.stamp_ns) == {}


def test_two_alike_networks_never_differ(frames: list[PosedFrame]) -> None:
    probed = ProbedStream.of(SETTINGS, Probing(second=str(SHIPPED)))
    assert probed is not None
    for number, _ in enumerate(probed(frames)):
        told = probed.take(frames[number].frame.stamp_ns)
        assert not told["ensemble"].any()


def test_only_streams_of_two_networks_are_probed() -> None:
    recorded = SETTINGS.model_copy(update={"supervised": "recorded"})
    assert ProbedStream.of(recorded, Probing()) is None
