"""Formats of a selection."""

import json

from service.curation.ranking import RankedScene
from service.curation.selection import Selection
from service.export.json_lines import json_lines

ROWS = tuple(
    RankedScene(
        rank=rank,
        scene_id=f"a/lidar/{rank}",
        log_id="a",
        start_ns=rank,
        end_ns=rank + 1,
        score=1.0 / rank,
        reasons=("it clashes",),
        twin_of=None,
        sha256="0" * 64,
    )
    for rank in (1, 2)
)
WEEK = Selection(name="week 47\n", strategy="best-distinct", budget=2, scenes=ROWS)


def test_json_has_a_line_for_each_scene_with_the_name_of_the_selection() -> None:
    lines = list(json_lines(WEEK))
    assert all(line.endswith("\n") and line.count("\n") == 1 for line in lines)
    assert [json.loads(line) for line in lines] == [
        {"selection": WEEK.name, "strategy": "best-distinct", **row.model_dump(mode="json")}
        for row in ROWS
    ]
