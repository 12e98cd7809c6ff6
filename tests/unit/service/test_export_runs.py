"""Runs of an export: whole or not at all, resumed, refused, and honest about what is missing."""

import errno
import json
from pathlib import Path

import pytest

from service.errors import StateInUseError, UsageError
from service.export import running
from service.export.formats import FORMATS, format_named
from service.export.journal import NAME, open_journal
from service.export.running import OutputFullError, run_export
from service.export.scene import SceneToExport
from tests.export_world import ExportWorld, files_of, made_world


@pytest.fixture
def world(tmp_path: Path) -> ExportWorld:
    return made_world(tmp_path)


def test_a_second_run_writes_nothing_again(world: ExportWorld, tmp_path: Path) -> None:
    week, out = world.selection(), tmp_path / "out"
    first = world.export(week, "mcap", out)
    before = {path: (out / path).stat().st_mtime_ns for path in files_of(out) if "mcap" in path}
    again = world.export(week, "mcap", out)
    after = {path: (out / path).stat().st_mtime_ns for path in files_of(out) if "mcap" in path}
    assert (len(first.written), first.kept) == (2, [])
    assert (again.written, len(again.kept)) == ({}, 2)
    assert before == after


def test_a_scene_that_was_removed_is_written_again(world: ExportWorld, tmp_path: Path) -> None:
    week, out = world.selection(), tmp_path / "out"
    report = world.export(week, "mcap", out)
    place = next(iter(report.written.values())).place
    (out / place).unlink()
    again = world.export(week, "mcap", out)
    assert [each.place for each in again.written.values()] == [place]


def test_a_full_disk_leaves_whole_scenes_and_the_next_run_goes_on(
    world: ExportWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    week, out = world.selection(), tmp_path / "out"
    settled = running._settled
    full = iter((False, True))

    def fills_up(path: Path) -> int:
        if next(full, False):
            raise OSError(errno.ENOSPC, "No space left on device")
        return settled(path)

    monkeypatch.setattr(running, "_settled", fills_up)
    with pytest.raises(OutputFullError, match="1 of 2 scenes are written whole"):
        world.export(week, "mcap", out)
    monkeypatch.undo()
    assert len([path for path in files_of(out) if path.endswith(".mcap")]) == 1
    assert not any("part" in path for path in files_of(out))
    again = world.export(week, "mcap", out)
    assert (len(again.written), len(again.kept)) == (1, 1)


def test_what_a_kill_left_behind_is_removed_and_a_cut_line_is_written_again(
    world: ExportWorld, tmp_path: Path
) -> None:
    week, out = world.selection(), tmp_path / "out"
    world.export(week, "mcap", out)
    journal = out / NAME
    journal.write_text(journal.read_text()[:-20])
    (out / ".counterpoint-export.part").mkdir()
    (out / ".counterpoint-export.part" / "half.mcap").write_bytes(b"half")
    again = world.export(week, "mcap", out)
    assert (len(again.written), len(again.kept)) == (1, 1)
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    assert len(lines) == 3
    assert not (out / ".counterpoint-export.part").exists()


def test_a_log_that_is_gone_is_named_and_the_rest_is_exported(
    world: ExportWorld, tmp_path: Path
) -> None:
    week = world.selection()
    lost = week.scenes[0].scene_id
    score = world.records[lost]
    world.records[lost] = score.model_copy(update={"log_id": "car-7/2026-11-20/gone"})
    report = world.export(week, "mcap", tmp_path / "out")
    assert list(report.missing) == [lost]
    assert report.missing[lost].startswith("no log car-7/2026-11-20/gone in ")
    assert len(report.written) == 1


def test_a_log_that_was_replaced_by_a_shorter_one_is_named(
    world: ExportWorld, tmp_path: Path
) -> None:
    from tests.export_world import write_log

    week = world.selection(scenes=1)
    write_log(world.bucket, frames=22)
    report = world.export(week, "mcap", tmp_path / "out")
    (why,) = report.missing.values()
    assert "no longer has 2 of 4 frames of the scene" in why


def test_a_folder_of_another_selection_is_refused(world: ExportWorld, tmp_path: Path) -> None:
    out = tmp_path / "out"
    world.export(world.selection(), "json", out)
    with pytest.raises(UsageError, match="export of selection 'week' as json: name another folder"):
        world.export(world.selection("other"), "json", out)
    with pytest.raises(UsageError, match="export of selection 'week' as json"):
        world.export(world.selection(), "mcap", out)
    with pytest.raises(UsageError, match="another selection of the name 'week', of another state"):
        world.export(world.selection(scenes=1), "json", out)


def test_a_folder_with_other_files_is_refused(world: ExportWorld, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("mine")
    with pytest.raises(UsageError, match="files that no export wrote"):
        world.export(world.selection(), "json", tmp_path / "out")


def test_two_exports_into_one_folder_at_once_are_refused(
    world: ExportWorld, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    week = world.selection()
    with (
        open_journal(out, week, format_name="json"),
        pytest.raises(StateInUseError, match="another export into this folder runs"),
    ):
        world.export(week, "json", out)


def test_a_scene_of_another_state_is_missing(world: ExportWorld, tmp_path: Path) -> None:
    week = world.selection()
    del world.records[week.scenes[1].scene_id]
    report = world.export(week, "json", tmp_path / "out")
    assert list(report.missing) == [week.scenes[1].scene_id]


def test_an_unknown_format_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(UsageError, match="no format 'csv': --format is one of mcap, semantickitti"):
        format_named("csv")


def test_points_are_freed_after_each_scene(world: ExportWorld, tmp_path: Path) -> None:
    opened: list[SceneToExport] = []
    week = world.selection()
    open_scene = world.opener(week)

    def remembered(number: int, row: object) -> SceneToExport:
        opened.append(open_scene(number, row))
        return opened[-1]

    (tmp_path / "out").mkdir()
    run_export(week, FORMATS["mcap"], tmp_path / "out", remembered)
    assert all("overlay" not in vars(each) for each in opened)
