"""DUFOMap as a comparator: what passes is dynamic, what stands is static, in one map of all."""

from collections.abc import Iterator

import numpy as np
import pytest

from schemas.arrays import NS_PER_S
from schemas.errors import PermanentError
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import MotionLabel
from workers.lab.evaluation.motion import dufomap
from workers.lab.evaluation.motion.dufomap import Dufomap


def wall_and_body(number: int, state: OdometryState = OdometryState.HEALTHY) -> PosedFrame:
    """A wall at 20 m that stands still, and a body before it that moves 3 m in each frame."""
    across, up = np.meshgrid(np.linspace(-12.0, 12.0, 241), np.linspace(-1.0, 1.0, 21))
    wall = np.stack([np.full(across.size, 20.0), across.ravel(), up.ravel()], axis=1)
    side, height = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.3, 0.3, 7))
    body = np.stack(
        [np.full(side.size, 10.0), side.ravel() - 6.0 + 3.0 * number, height.ravel()], axis=1
    )
    points = np.concatenate([wall, body, [[0.5, 0.0, 0.0]]]).astype(np.float32)
    n = len(points)
    frame = LidarFrame(
        log_id="made",
        stamp_ns=number * NS_PER_S // 10,
        points_m=points,
        intensity=np.zeros(n, np.float32),
        offset_ns=np.zeros(n, np.int32),
        ring=np.full(n, -1, np.int16),
        valid_mask=np.ones(n, np.bool_),
    )
    return PosedFrame(frame, np.eye(4), odometry=state)


WALL = 241 * 21


def test_a_body_that_passes_is_dynamic_and_the_wall_is_static() -> None:
    answers = list(Dufomap()(wall_and_body(number) for number in range(5)))
    assert len(answers) == 5
    for labels in answers[1:4]:
        wall, body = labels.labels[:WALL], labels.labels[WALL:-1]
        assert (body == MotionLabel.DYNAMIC).mean() > 0.9
        assert (wall == MotionLabel.STATIC).mean() > 0.9
        assert labels.labels[-1] == MotionLabel.UNKNOWN  # the own car
        assert labels.confidence[-1] == 0


def test_a_frame_without_a_pose_is_unknown_and_not_in_the_map() -> None:
    frames = [wall_and_body(0), wall_and_body(1, OdometryState.LOST), wall_and_body(2)]
    answers = list(Dufomap()(frames))
    assert (answers[1].labels == MotionLabel.UNKNOWN).all()
    assert (answers[0].labels == MotionLabel.STATIC).any()


def test_a_log_that_is_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dufomap, "MOST_FRAMES", 2)

    def frames() -> Iterator[PosedFrame]:
        yield from (wall_and_body(number) for number in range(3))

    with pytest.raises(PermanentError, match="2 frames at most"):
        next(Dufomap()(frames()))


def test_without_the_package_a_sentence_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dufomap, "find_spec", lambda name: None)
    with pytest.raises(PermanentError, match=r"counterpoint\[dufomap\]"):
        Dufomap()
