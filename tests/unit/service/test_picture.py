import io
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from schemas.contradiction import Scene
from schemas.frame import OdometryState
from schemas.labels import Agreement, MotionLabel
from schemas.overlay import NO_POSITION_CM, Overlay
from schemas.score import Reason, SceneScore
from schemas.task import MOTION
from service.pictures.above import draw_above
from service.pictures.camera import ImageUnreadableError
from service.pictures.scene import draw_camera, draw_scene, strongest_frame
from service.pictures.style import WITNESS_INK, colours_of, font, inks_of, shorten, wrap
from service.pictures.title import title_of
from service.pictures.view import View
from tests.labelled_worlds import CLASS_NAMES, Thing, labelled_scene, ranked_tracks, shard_of
from tests.overlays import labels_of_points
from workers.contradiction.instances import find_instances
from workers.contradiction.overlay import overlay_of
from workers.contradiction.score import score_scene

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
MISSED = Thing((-8, 6, 0), STATIC, DYNAMIC, velocity_m_per_s=(6, 0, 0), points=900)
PHANTOM = Thing((12, -6, 0), DYNAMIC, STATIC, class_id=2, size_m=(3, 2, 1.7), points=900)
AGREED = Thing((-14, -6, 0), DYNAMIC, DYNAMIC, points=900)
WALL = Thing((0, 15, 1), STATIC, STATIC, size_m=(40, 1.0, 4), points=9000)


@dataclass(frozen=True)
class _Part:
    version: str = "part@0123456789ab"


@dataclass(frozen=True)
class _Streams:
    supervised: _Part = _Part()
    selfsupervised: _Part = _Part()
    own_model: str = ""


def mined_scene(scene: Scene) -> tuple[SceneScore, Overlay]:
    instances = find_instances(scene, class_names=CLASS_NAMES)
    tracks = ranked_tracks(scene, instances)
    score = score_scene(
        shard_of(), scene, instances, tracks, parts=_Streams(), pipeline_version="abcdef012345"
    )
    return score, overlay_of(scene, instances, tracks, class_names=CLASS_NAMES)


def _reasons(*headlines: str) -> tuple[Reason, ...]:
    return tuple(Reason(headline=each, track_id=i) for i, each in enumerate(headlines))


@pytest.fixture(scope="module")
def mined() -> tuple[SceneScore, Overlay]:
    return mined_scene(labelled_scene([WALL, AGREED, MISSED, PHANTOM], frames=12))


def _pixels(image: Image.Image) -> NDArray[np.uint8]:
    return np.asarray(image.convert("RGB"))


def _where(pixels: NDArray[np.uint8], agreement: Agreement) -> NDArray[np.int64]:
    same = (pixels == np.array(colours_of(MOTION)[agreement], dtype=np.uint8)).all(axis=2)
    return np.argwhere(same)


@pytest.mark.parametrize(
    ("agreement", "thing"),
    [
        (Agreement.BOTH_STATIC, WALL),
        (Agreement.BOTH_DYNAMIC, AGREED),
        (Agreement.ONLY_PREDICTIVE_DYNAMIC, MISSED),
        (Agreement.ONLY_SEMANTIC_DYNAMIC, PHANTOM),
    ],
)
def test_a_thing_lies_where_it_is_seen_from_above_in_its_own_colour(
    mined: tuple[SceneScore, Overlay], agreement: Agreement, thing: Thing
) -> None:
    view = View(frame=0, centre_m=(0.0, 0.0), half_m=30.0, size_px=900)
    image = _pixels(draw_above(mined[1], view, background=False, rings=False))
    found = _where(image, agreement)
    assert len(found) > 200
    forward_px, left_px = 450 - np.median(found, axis=0)
    assert forward_px / 15 == pytest.approx(thing.at_m[0], abs=1.0)
    assert left_px / 15 == pytest.approx(thing.at_m[1], abs=1.0)


def test_the_picture_is_the_same_every_time_and_as_wide_as_a_page(
    mined: tuple[SceneScore, Overlay],
) -> None:
    image = draw_scene(*mined)
    assert image.size == (1720, 1250)
    assert image.tobytes() == draw_scene(*mined).tobytes()


def test_all_four_colours_and_the_legend_are_in_the_picture(
    mined: tuple[SceneScore, Overlay],
) -> None:
    pixels = _pixels(draw_scene(*mined))
    for agreement in Agreement:
        legend = _where(pixels[-150:, 1050:], agreement)
        assert len(legend) >= 15 * 15, agreement
    assert len(_where(pixels[:, :1040], Agreement.ONLY_PREDICTIVE_DYNAMIC)) > 100


def test_the_legend_explains_every_box_of_the_witness_that_is_drawn(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    ink = np.array(WITNESS_INK, dtype=np.uint8)
    corner = slice(-260, None), slice(1180, None)

    def entries(shown: Overlay) -> int:
        return int((_pixels(draw_scene(score, shown))[corner] == ink).all(axis=2).sum())

    kinds = np.full_like(overlay.instance_kind, Agreement.BOTH_STATIC)
    assert entries(overlay) == 0
    assert entries(replace(overlay, instance_kind=kinds)) > 40


def test_the_frame_with_the_strongest_evidence_is_shown_unless_another_is_asked_for(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    frame = strongest_frame(score, overlay)
    assert overlay.stamps_ns[frame] == score.tracks[0].strongest.stamp_ns
    assert draw_scene(score, overlay).tobytes() == draw_scene(score, overlay, frame=frame).tobytes()
    other = (frame + 6) % 12
    assert draw_scene(score, overlay).tobytes() != draw_scene(score, overlay, frame=other).tobytes()


def test_frames_are_laid_over_each_other_by_their_poses() -> None:
    _, overlay = mined_scene(labelled_scene([WALL], frames=12, ego_m_per_s=10))
    view = View(frame=0, centre_m=(0.0, 0.0), half_m=30.0, size_px=600)
    faint = _pixels(draw_above(overlay, view, rings=False))
    bare = _pixels(draw_above(overlay, view, rings=False, background=False))
    added = np.argwhere((faint != bare).any(axis=2))
    wall = _where(bare, Agreement.BOTH_STATIC)
    # The sensor drives 11 m, the wall stands still: what other frames saw of it adds nothing.
    assert len(added) < 0.05 * len(wall)


@pytest.mark.parametrize("frame", [-1, 12])
def test_a_frame_that_the_scene_has_not_is_refused(
    mined: tuple[SceneScore, Overlay], frame: int
) -> None:
    with pytest.raises(ValueError, match="scene has frames 0 to 11"):
        draw_scene(*mined, frame=frame)


def test_the_overlay_of_another_scene_is_refused(mined: tuple[SceneScore, Overlay]) -> None:
    score, overlay = mined
    with pytest.raises(ValueError, match="overlay is of another/scene"):
        draw_scene(score, replace(overlay, scene_id="another/scene"))


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(labelled_scene([WALL], frames=2), id="nothing contradicts"),
        pytest.param(labelled_scene([], frames=2), id="no point at all"),
        pytest.param(labelled_scene([MISSED], frames=1, too_short=True), id="too short"),
        pytest.param(
            labelled_scene([MISSED], frames=3, odometry=[OdometryState.LOST] * 3), id="lost"
        ),
        pytest.param(
            labelled_scene([Thing((5, 5, 0), UNKNOWN, UNKNOWN)], frames=2), id="not compared"
        ),
    ],
)
def test_scenes_with_little_to_show_are_drawn_all_the_same(scene: Scene) -> None:
    assert draw_scene(*mined_scene(scene)).size == (1720, 1250)


def test_names_of_any_length_and_script_are_drawn(mined: tuple[SceneScore, Overlay]) -> None:
    score, overlay = mined
    name = "東京/" + "a" * 400
    renamed = score.model_copy(
        update={"scene_id": name, "reasons": _reasons("x" * 500, "word " * 90)}
    )
    assert draw_scene(renamed, replace(overlay, scene_id=name)).size == (1720, 1250)


def test_what_gated_a_scene_is_told_without_the_number_and_colour_of_a_track(
    mined: tuple[SceneScore, Overlay],
) -> None:
    score, overlay = mined
    ink = inks_of(MOTION)[MOTION.kind(score.tracks[0].kind).code]

    def inked(*reasons: Reason) -> int:
        picture = draw_scene(score.model_copy(update={"reasons": reasons}), overlay)
        return int((_pixels(picture) == np.array(ink, np.uint8)).all(axis=2).sum())

    assert inked(Reason(headline="supervised calls car static", track_id=0)) > inked()
    for gate in (
        "self-supervised stream blind in 25% of the frames",
        "odometry degraded in 50% of the frames",
    ):
        assert inked(Reason(headline=gate)) == inked()


def test_long_words_are_cut_in_their_middle_and_long_sentences_wrapped() -> None:
    cut = shorten("fleet/car-7/2026-11-20/drive-000123", 150, 16)
    assert cut.startswith("fleet")
    assert cut.endswith("123")
    assert font(16).getlength(cut) <= 150
    lines = wrap("a car that nobody sees " * 6, 200, 16, max_lines=3)
    assert len(lines) == 3
    assert all(font(16).getlength(line) <= 200 for line in lines)
    assert wrap("short", 200, 16, max_lines=3) == ["short"]


def test_what_is_too_much_for_its_lines_is_left_out_after_a_word() -> None:
    said = "car seen moving by the supervised stream alone; the supervised stream errs (87%)"
    first, last = wrap(said, 200, 16, max_lines=2)
    assert last.endswith("...")
    kept = f"{first} {last.removesuffix('...')}"
    assert said.startswith(kept)
    assert said[len(kept)] in " ,;", "after a word"
    assert font(16).getlength(last) <= 200
    assert " ".join(wrap(said, 200, 16, max_lines=9)) == said


def _photo(width: int = 1600, height: int = 48) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height), (90, 90, 90)).save(out, format="PNG")
    return out.getvalue()


def _tiny(agreements: list[Agreement]) -> Overlay:
    n = len(agreements)
    none = np.zeros(0, dtype=np.int32)
    return Overlay(
        scene_id="s",
        stamps_ns=np.zeros(1, dtype=np.int64),
        offsets=np.array([0, n]),
        points_cm=np.full((n, 3), 100, dtype=np.int16),
        **labels_of_points(np.array(agreements, dtype=np.uint8)),
        ground_mask=np.zeros(n, dtype=np.bool_),
        class_id=np.full(n, -1, dtype=np.int16),
        class_names=(),
        semantic_confidence=np.zeros(n, dtype=np.uint8),
        predictive_confidence=np.zeros(n, dtype=np.uint8),
        instance_index=np.full(n, -1, dtype=np.int32),
        odom_from_sensor=np.eye(4)[None],
        instance_frame=none,
        instance_kind=np.zeros(0, dtype=np.uint8),
        instance_track=none,
        instance_boxes=np.zeros((0, 7), dtype=np.float32),
    )


def test_points_on_the_camera_image_are_circles_of_two_pixels_with_contradictions_on_top() -> None:
    overlay = _tiny(
        [Agreement.ONLY_PREDICTIVE_DYNAMIC, Agreement.BOTH_STATIC, Agreement.BOTH_DYNAMIC]
    )
    at_px = np.array([[20.7, 10.2], [20.7, 10.2], [40.0, 30.0]])
    image = _pixels(
        draw_camera(_photo(), overlay, frame=0, at_px=at_px, inside_mask=np.ones(3, dtype=np.bool_))
    )[:48]
    assert len(_where(image, Agreement.BOTH_STATIC)) == 0
    for agreement, centre in (
        (Agreement.ONLY_PREDICTIVE_DYNAMIC, (10, 20)),
        (Agreement.BOTH_DYNAMIC, (30, 40)),
    ):
        found = _where(image, agreement)
        assert np.median(found, axis=0).tolist() == list(centre)
        assert np.ptp(found, axis=0).tolist() == [4, 4]
        assert 13 <= len(found) <= 21


def test_a_small_image_is_enlarged_so_that_circles_do_not_hide_it() -> None:
    image = draw_camera(
        _photo(800, 100),
        _tiny([Agreement.BOTH_DYNAMIC]),
        frame=0,
        at_px=np.array([[400.0, 50.0]]),
        inside_mask=np.ones(1, dtype=np.bool_),
    )
    assert image.width == 1600
    found = _where(_pixels(image)[:200], Agreement.BOTH_DYNAMIC)
    assert np.median(found, axis=0).tolist() == [100, 800]
    assert np.ptp(found, axis=0).tolist() == [4, 4]


def test_points_outside_the_image_or_without_a_position_are_left_out() -> None:
    overlay = _tiny([Agreement.BOTH_STATIC, Agreement.BOTH_STATIC, Agreement.NOT_COMPARED])
    points_cm = np.full((3, 3), 100, dtype=np.int16)
    points_cm[1] = NO_POSITION_CM
    image = draw_camera(
        _photo(),
        replace(overlay, points_cm=points_cm),
        frame=0,
        at_px=np.array([[np.inf, 1e9], [5.0, 5.0], [9.0, 9.0]]),
        inside_mask=np.array([False, True, True]),
    )
    assert (_pixels(image)[:48] == 90).all()


def test_bytes_that_are_no_image_are_refused() -> None:
    with pytest.raises(ImageUnreadableError, match="cannot read the camera image"):
        draw_camera(
            b"no image",
            _tiny([]),
            frame=0,
            at_px=np.zeros((0, 2)),
            inside_mask=np.zeros(0, dtype=np.bool_),
        )


def test_pixels_of_another_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="frame 0 has 1 points, got 2 pixels"):
        draw_camera(
            _photo(),
            _tiny([Agreement.BOTH_STATIC]),
            frame=0,
            at_px=np.zeros((2, 2)),
            inside_mask=np.zeros(1, dtype=np.bool_),
        )


def test_a_title_names_rank_score_and_scene(mined: tuple[SceneScore, Overlay]) -> None:
    score, overlay = mined
    assert title_of(score).text == f"{score.score:.3f} | drive@2023-11-14T22:13:20.0"
    ranked = title_of(score, rank=3, name="b/drive@x")
    assert ranked.text == f"rank 3 | {score.score:.3f} | b/drive@x"
    assert ranked.place == "rank 3 | b/drive@x"
    assert (
        draw_scene(score, overlay).tobytes() != draw_scene(score, overlay, title=ranked).tobytes()
    )


def test_a_number_keeps_its_unit_on_its_line() -> None:
    for width in range(120, 400, 10):
        for line in wrap("moves at 1.4 m/s, 25 m behind, for 2 s: 82 %", width, 16, max_lines=9):
            assert not line.startswith(("m/s", "m ", "s:", "%"))
