"""Charts are shapes of the right places; phrases; thumbnails within their bound."""

import re

import pytest
from PIL import Image

from service.web.charts import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    Sample,
    bar_chart,
    line_chart,
)
from service.web.filters import Filters
from service.web.phrases import (
    counted,
    instant_of_s,
    percent,
    scene_name,
    score,
    with_units,
)
from service.web.thumbnails import Thumbnails, png_of


def samples(*values: float | None, places: tuple[int, ...] = ()) -> list[Sample]:
    return [
        Sample((places or range(100))[i], f"d{i}", value, f"t{i}", f"/?d={i}")
        for i, value in enumerate(values)
    ]


def test_a_line_goes_through_its_values_between_the_margins() -> None:
    chart = line_chart(samples(0.0, 0.5, 1.0), top=1.0)
    ys = [mark.y for mark in chart.marks]
    assert ys == [HEIGHT - BOTTOM, (HEIGHT - BOTTOM + TOP) / 2, TOP]
    assert all(LEFT < mark.x < WIDTH - RIGHT for mark in chart.marks)
    assert chart.line.count("M") == 1
    assert [mark.href for mark in chart.marks] == ["/?d=0", "/?d=1", "/?d=2"]


def test_a_gap_in_time_or_a_missing_value_breaks_the_line() -> None:
    assert line_chart(samples(1, 1, 1, places=(0, 1, 9))).line.count("M") == 2
    chart = line_chart(samples(1, None, 1))
    assert chart.line.count("M") == 2
    assert len(chart.marks) == 2


def test_an_interval_is_a_band() -> None:
    bounded = [Sample(i, "", 0.5, "", "", 0.25, 0.75) for i in range(3)]
    assert len(re.findall(r"[ML]", line_chart(bounded, top=1.0).band)) == 6


@pytest.mark.parametrize("values", [(), (0.0,), (1e-9,), (1e12,), (0.0,) * 5])
def test_any_values_make_a_chart(values: tuple[float, ...]) -> None:
    for chart in (line_chart(samples(*values)), bar_chart(samples(*values))):
        assert all(TOP <= mark.y <= HEIGHT - BOTTOM for mark in chart.marks)
        assert len(chart.ticks) == 3


def test_bars_stand_on_the_axis() -> None:
    chart = bar_chart(samples(3, 7))
    assert {round(mark.y + mark.height, 6) for mark in chart.marks} == {HEIGHT - BOTTOM}


@pytest.mark.parametrize(
    ("most", "labels"),
    [
        (1, ["0", "1", "2"]),
        (3, ["0", "2", "4"]),
        (5, ["0", "3", "6"]),
        (17, ["0", "10", "20"]),
        (1_234, ["0", "1\u202f000", "2\u202f000"]),
    ],
)
def test_counts_have_a_grid_of_integers(most: int, labels: list[str]) -> None:
    assert [label for _, label in bar_chart(samples(most)).ticks] == labels


def test_phrases() -> None:
    assert score(0.9999) == "1.000"
    assert score(0.996) == "0.996"
    assert score(0.42) == "0.42"
    assert percent(0.0123, 2) == "1.23 %"
    assert counted(1, "scene") == "1 scene"
    assert counted(12_345, "scene") == "12\u202f345 scenes"
    assert with_units("14.4 m/s, 18 m left, 95 %") == "14.4\u00a0m/s, 18\u00a0m left, 95\u00a0%"
    assert scene_name("a/b/drive/lidar/1772442064000000000") == "drive@2026-03-02T09:01:04.0"
    assert scene_name("odd") == "odd"
    assert scene_name("a/b/" + "9" * 40) == "a/b/" + "9" * 40
    assert instant_of_s(1e300) == f"{1e300:.0f} s"


def test_an_address_keeps_its_filters() -> None:
    filters = Filters.of({"vehicle": "a&b", "q": " ", "after": "x", "unknown": "y"})
    assert filters.query() == "?vehicle=a%26b&after=x"
    assert filters.query(after=None, kind="k") == "?vehicle=a%26b&kind=k"
    assert filters.chips() == [("vehicle: a&b", "")]


def test_thumbnails_are_dropped_beyond_their_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []

    class Source:
        def scene(self, scene_id: str) -> str:
            drawn.append(scene_id)
            return scene_id

    monkeypatch.setattr("service.web.thumbnails.overlay_of", lambda source, scene_id: None)
    monkeypatch.setattr(
        "service.web.thumbnails.draw_thumbnail", lambda *_: Image.new("RGB", (352, 264))
    )
    size = len(png_of(Image.new("RGB", (352, 264))))
    kept = Thumbnails(max_bytes=2 * size)
    for name in ("a", "b", "a", "c", "a", "b"):
        if kept.kept(name, "digest") is None:
            kept.drawn(Source(), name, "digest")  # type: ignore[arg-type]
    assert drawn == ["a", "b", "c", "b"], "b was used least recently when c came"
