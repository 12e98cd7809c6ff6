"""A mover that passes a parked car within half a metre."""

import numpy as np
from numpy.typing import NDArray

from workers.witness.free_space import _moving


def _block(x_m: float, y_m: float, length_m: float, width_m: float) -> NDArray[np.float32]:
    """Return the places of a box, 0.2 m apart and 1.6 m high."""
    axes = [np.arange(0.0, side, 0.2) for side in (length_m, width_m, 1.6)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    return np.asarray(grid + np.array([x_m, y_m, 0.0]), np.float32)


PARKED, MOVER = _block(0.0, 0.0, 4.0, 1.8), _block(0.0, 2.05, 4.0, 1.8)


def _labels(mover_free_share: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return what moves of the parked car and of the mover, of which a share was seen through."""
    places = np.concatenate([PARKED, MOVER])
    free = np.zeros(len(places), np.bool_)
    first = np.flatnonzero(MOVER[:, 0] < 4.0 * mover_free_share) + len(PARKED)
    free[first] = True
    moves = _moving(places, free, np.ones(len(places), np.bool_))
    return moves[: len(PARKED)], moves[len(PARKED) :]


def test_a_parked_car_next_to_a_mover_stands() -> None:
    gap_m = MOVER[:, 1].min() - PARKED[:, 1].max()
    assert 0.3 < gap_m < 0.5
    parked, mover = _labels(0.9)
    assert not parked.any()
    assert mover.all()


def test_a_mover_alone_moves_as_a_whole() -> None:
    free = MOVER[:, 0] < 1.6
    assert _moving(MOVER, free, np.ones(len(MOVER), np.bool_)).all()
