import json
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import TextColumn

from service.cli import output
from service.cli.report import first_of

ROOT = Path(__file__).resolve().parents[3]


def test_where_no_bar_can_be_drawn_a_line_says_how_far_the_work_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [100.0]
    monkeypatch.setattr(output, "monotonic", lambda: now_s[0])
    with output.progress() as bar:
        task = bar.add_task("mining", total=None)
        bar.update(task, completed=1, total=20)
        now_s[0] += output.LINE_EVERY_S
        bar.update(task, completed=7, total=20)
        bar.update(task, completed=8, total=20)
    assert capsys.readouterr().err == "mining: 7 of 20\n"


ROW = (1, 0.5, "car-1/2026-03-02/drive/lidar.top.points/" + "9" * 100, "a reason " * 40)


@pytest.mark.parametrize(("columns", "wide"), [("", 120), ("150", 150), ("40", 40)])
def test_a_table_in_a_pipe_is_as_wide_as_columns_say_or_a_page(columns: str, wide: int) -> None:
    code = "from service.cli.output import table; table('t', ('rank', 'why'), [(1, 'word ' * 99)])"
    environment = (
        {"PYTHONPATH": str(ROOT), "COLUMNS": columns} if columns else {"PYTHONPATH": str(ROOT)}
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert wide - 6 < max(map(len, done.stdout.splitlines())) <= wide


def test_names_are_whole_and_numbers_in_one_piece_however_narrow_it_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    output.table("scenes", ("rank", "score", "scene", "why"), [ROW])
    lines = capsys.readouterr().out.splitlines()
    (first,) = [line for line in lines if ROW[2] in line]
    assert "0.500" in first


def test_headers_are_broken_where_long_cells_need_the_room(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output.results, "width", 60)
    output.table("t", ("twin of any rank", "why"), [(1, "word " * 40)])
    crowded = capsys.readouterr().out
    output.table("t", ("twin of any rank", "why"), [(1, "word")])
    roomy = capsys.readouterr().out
    assert "twin of any rank" in roomy
    assert "twin of any rank" not in crowded
    assert max(line.count("word") for line in crowded.splitlines()) == 10


def test_the_headline_of_a_scene_is_that_of_its_first_reason() -> None:
    assert first_of(()) == ""
    assert first_of(("one", "two")) == "one"


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_listing_has_a_sentence_below_each_row_and_breaks_it_only_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *, is_terminal: bool
) -> None:
    monkeypatch.setattr(output.results, "width", 60)
    monkeypatch.setattr(output.results, "_force_terminal", is_terminal)
    sentence = "word " * 20 + "end \x1b[2J"
    output.listing("two rows", ("rank", "name"), [((1, "a" * 70), sentence), ((22, None), "")])
    printed = [line for line in capsys.readouterr().out.splitlines() if "two rows" not in line]
    assert "a" * 70 in printed[1]
    shown = printed[2:-1]
    assert " ".join(line.strip() for line in shown) == "word " * 20 + r"end \x1b[2J"
    assert len(shown) == (3 if is_terminal else 1)
    assert all(line.startswith("      ") for line in shown)
    assert printed[-1].strip() == "22"


STEERING = "\x1b]52;c;aGk=\x07\x1b[2J\x9b31m\u202e\n\udcff[red][/][link=x]:smile:"
SHOWN = r"\x1b]52;c;aGk=\x07\x1b[2J\x9b31m\u202e\n\xff[red][/][link=x]:smile:"


def test_what_steers_a_terminal_is_shown_and_markup_is_not_read(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output.results, "width", 400)
    output.table(f"title {STEERING}", (f"name {STEERING}", "2"), [(STEERING, 1), ("b", STEERING)])
    output.result_line(STEERING)
    output.remark(STEERING)
    with output.progress() as bar:
        bar.add_task(STEERING)
    written = capsys.readouterr()
    for text in (written.out, written.err):
        assert all(char.isprintable() or char == "\n" for char in text)
    assert written.out.count(SHOWN) == 5
    assert written.err == SHOWN + "\n"


def test_json_keeps_what_steers_a_terminal_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    output.json_line({"vehicle": STEERING})
    (line,) = capsys.readouterr().out.splitlines()
    assert line.isascii()
    assert line.isprintable()
    assert json.loads(line)["vehicle"] == STEERING


def test_a_bar_on_a_terminal_shows_what_would_steer_it() -> None:
    shown = Console(file=StringIO(), force_terminal=True, width=300)
    with output._Bar(TextColumn("{task.description}", markup=False), console=shown) as bar:
        task = bar.add_task(STEERING)
        bar.update(task, description=f"mining {STEERING}")
        assert bar.tasks[0].description == f"mining {SHOWN}"
