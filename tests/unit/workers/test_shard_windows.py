"""Windows cover a log once, on one grid, and look ahead only where the index leaves a doubt."""

import pytest

from schemas.mining import Grid
from schemas.work import ChunkRef
from workers.ingest.shard_windows import Span, Spans, Window, cut_windows, is_continuous

S = 1_000_000_000
MS = 1_000_000
ANCHOR_NS = 1000 * S


def span(start_s: float, end_s: float, messages: int = -1) -> Span:
    start_ns, end_ns = (ANCHOR_NS + round(at_s * S) for at_s in (start_s, end_s))
    ref = ChunkRef(part=0, offset=start_ns, length=10, start_ns=start_ns, end_ns=end_ns)
    return Span(ref, earliest_ns=start_ns, latest_ns=end_ns, messages=messages)


def chunks(start_s: float, end_s: float, *, frames: int = 2, step_s: float = 0.1) -> list[Span]:
    """Chunks of some frames each, without a gap, the last frame before the end."""
    count = round((end_s - start_s) / step_s)
    return [
        span(
            start_s + first * step_s,
            start_s + (min(first + frames, count) - 1) * step_s,
            min(frames, count - first),
        )
        for first in range(0, count, frames)
    ]


def cut(
    spans: list[Span], *, shard_s: float = 4.0, scene_s: float = 2.0, step_ms: int = 90
) -> list[Window]:
    grid = Grid(scene_s=scene_s, shard_s=shard_s)
    return cut_windows(spans, grid=grid, anchor_ns=ANCHOR_NS, least_step_ns=step_ms * MS)


def times_s(window: Window) -> tuple[float, float]:
    return (window.start_ns - ANCHOR_NS) / S, (window.end_ns - ANCHOR_NS) / S


def test_windows_are_whole_multiples_of_the_shard_from_the_first_frame() -> None:
    windows = cut(chunks(0, 11))
    assert [window.index for window in windows] == [0, 1, 2]
    assert [times_s(window) for window in windows] == [(0, 4), (4, 8), (8, 12)]
    assert [window.first_of_log for window in windows] == [True, False, False]
    assert [window.last_of_log for window in windows] == [False, False, True]


def test_a_shard_warms_up_before_its_window_but_not_before_the_log() -> None:
    windows = cut(chunks(0, 11))
    warmups_s = [(window.start_ns - window.warmup_start_ns) / S for window in windows]
    assert warmups_s == [0, 1.2, 1.2]


def test_less_than_the_shortest_scene_at_the_end_belongs_to_the_shard_before() -> None:
    windows = cut(chunks(0, 8.9))
    assert [window.index for window in windows] == [0, 1]
    assert windows[-1].last_of_log
    assert windows[-1].end_ns == ANCHOR_NS + round(8.8 * S) + 1


def test_a_whole_second_at_the_end_is_a_shard_of_its_own() -> None:
    assert len(cut(chunks(0, 9.2))) == 3


def test_a_short_end_after_an_empty_window_stands_alone() -> None:
    windows = cut([*chunks(0, 4), *chunks(8.1, 8.8)])
    assert [window.index for window in windows] == [0, 2]


def test_a_log_shorter_than_a_scene_is_one_shard() -> None:
    (window,) = cut(chunks(0, 0.5))
    assert window.first_of_log
    assert window.last_of_log


def test_windows_without_chunks_are_left_out() -> None:
    windows = cut([*chunks(0, 3), *chunks(16.5, 19)])
    assert [window.index for window in windows] == [0, 4]
    assert windows[1].before_lookahead_end_ns == 0


def test_frames_before_the_anchor_belong_to_the_first_window() -> None:
    windows = cut([span(-3, -2.9, 2), *chunks(0, 3)])
    assert [window.index for window in windows] == [0]
    assert windows[0].reads(Spans([span(-3, -2.9)]))


@pytest.mark.parametrize("frames", [1, 2, 4, 8, 20])
def test_no_shard_looks_ahead_where_the_index_proves_that_frames_go_on(frames: int) -> None:
    windows = cut(chunks(0, 90, frames=frames), shard_s=20)
    proven = windows[:-2]  # the last boundary may lie too near the end
    assert len(proven) >= 3
    assert all(window.lookahead_end_ns == window.end_ns for window in proven)


def test_a_shard_looks_ahead_where_frames_may_end_soon_after_its_window() -> None:
    windows = cut([*chunks(0, 4.4), *chunks(5.5, 12)])
    assert windows[0].lookahead_end_ns == windows[0].end_ns + 2 * S
    assert windows[1].before_lookahead_end_ns == windows[0].lookahead_end_ns
    assert windows[0].reads(Spans([span(5.9, 6.1)]))
    assert not windows[0].needs(Spans([span(5.9, 6.1)]))


def test_the_last_shard_has_nothing_to_look_ahead_to() -> None:
    window = cut(chunks(0, 11))[-1]
    assert window.lookahead_end_ns == window.end_ns


@pytest.mark.parametrize("step_ms", [0, 90])
def test_a_chunk_of_unknown_content_proves_nothing(step_ms: int) -> None:
    spans = [span(each.earliest_ns / S - 1000, each.latest_ns / S - 1000) for each in chunks(0, 9)]
    assert not is_continuous(
        spans,
        start_ns=ANCHOR_NS + 4 * S,
        end_ns=ANCHOR_NS + 5 * S,
        max_gap_ns=S // 2,
        least_step_ns=step_ms * MS,
    )


@pytest.mark.parametrize(
    ("gap", "continuous"),
    [
        pytest.param((4.3, 4.9), False, id="a gap after the boundary"),
        pytest.param((3.8, 4.5), False, id="a gap across the boundary"),
        pytest.param((5.3, 6.0), False, id="a gap before the stretch ends"),
        pytest.param((2.0, 3.0), True, id="a gap well before"),
        pytest.param((6.2, 8.0), True, id="a gap well after"),
    ],
)
def test_continuity_is_never_claimed_across_a_gap(
    gap: tuple[float, float], continuous: bool
) -> None:
    spans = [*chunks(0, gap[0]), *chunks(gap[1], 12)]
    assert continuous == is_continuous(
        spans,
        start_ns=ANCHOR_NS + 4 * S,
        end_ns=ANCHOR_NS + round(5.5 * S),
        max_gap_ns=S // 2,
        least_step_ns=90 * MS,
    )


def test_a_gap_hidden_inside_a_chunk_is_seen_by_its_missing_messages() -> None:
    whole, missing = span(3.9, 5.8, 20), span(3.9, 5.8, 14)
    for one, continuous in ((whole, True), (missing, False)):
        assert continuous == is_continuous(
            [*chunks(0, 3.9), one, *chunks(5.9, 9)],
            start_ns=ANCHOR_NS + 4 * S,
            end_ns=ANCHOR_NS + round(5.4 * S),
            max_gap_ns=S // 2,
            least_step_ns=90 * MS,
        )


def test_cells_of_a_fraction_of_a_second_do_not_drift() -> None:
    windows = cut(chunks(0, 30), scene_s=0.7, shard_s=2.1)
    assert all((window.start_ns - ANCHOR_NS) % (700 * MS) == 0 for window in windows)


def test_chunks_are_given_once_and_by_log_time() -> None:
    later, earlier = span(2, 3), span(1, 2)
    twice = Span(later.ref, earliest_ns=0, latest_ns=1, messages=-1)
    found = Spans([later, earlier, twice]).between(None, None)
    assert found == [earlier.ref, later.ref]


def test_a_stream_that_looks_ahead_is_given_the_frames_after_every_window_but_the_last() -> None:
    grid = Grid(scene_s=2.0, shard_s=4.0)
    windows = cut_windows(
        chunks(0, 11), grid=grid, anchor_ns=ANCHOR_NS, least_step_ns=90 * MS, ahead_ns=S
    )
    assert [w.lookahead_end_ns - w.end_ns for w in windows] == [S, S, 0]
    assert [w.before_lookahead_end_ns for w in windows] == [
        0,
        windows[0].lookahead_end_ns,
        windows[1].lookahead_end_ns,
    ]
