"""What is recommended is the fastest part whose labels stay."""

import pytest

from workers.evaluation.network_time import Network, NetworkTime, recommended, times_as_fast


def _row(network: Network, way: str, median_ms: float, changed: float = 0.0) -> NetworkTime:
    return NetworkTime(
        network=network, way=way, size="64 x 1024", median_ms=median_ms, faster=1.0, changed=changed
    )


def test_the_fastest_part_whose_labels_stay_is_recommended() -> None:
    plain = [_row("salsanext", "plain", 1.0), _row("lmnet", "plain", 1.0)]
    eager = [_row("salsanext", "eager", 30.0), _row("lmnet", "eager", 30.0)]
    folded = [_row("salsanext", "folded", 20.0), _row("lmnet", "folded", 35.0)]
    assert recommended(plain + eager + folded) == "salsanext-lmnet:folded"
    slower = [_row("salsanext", "folded", 28.0), _row("lmnet", "folded", 35.0)]
    assert recommended(plain + eager + slower) == "salsanext-lmnet"
    wrong = [_row("salsanext", "folded", 1.0, 0.01), _row("lmnet", "folded", 1.0)]
    assert recommended(plain + eager + wrong) == "salsanext-lmnet"
    assert recommended([_row("flowstep3d", "ours", 1.0)]) == ""


def test_a_ratio_is_that_of_pairs() -> None:
    assert times_as_fast([2.0, 20.0, 6.0], [1.0, 10.0, 2.0]) == pytest.approx(2.0)
