"""Export real scenes in every format, label a part of their points, import, and count the points.

`python -m tests.benchmark.returned_labels STATE SELECTION LOGS [FORMAT …]` reads a state with a
stored selection. It exports by the command, and compares every written point with the message of
the log. Then a seeded rule changes labels in the exported files, the command imports them, and the
labels of every raw point are compared. A row is printed for each form of labels; seconds are of the
processor.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from schemas.overlay import NO_POSITION_CM, Overlay
from schemas.score import SceneScore
from schemas.transport.overlay_codec import decode_overlay
from schemas.transport.wire import decode
from service.cli.scenes import reader
from service.export.journal import scenes_of
from service.export.label_import import read_scenes
from service.export.labels.forms import form_named
from tests.exported_points import READERS, points_of, raw_clouds
from tests.returned_labels import LABELLERS, Labelled, label_openlabel

Current = Callable[[str], tuple[SceneScore, Overlay]]

_EXACT_M = 1e-6
_ROUNDED_M = 0.003


def main(state: str, selection: str, logs: str, *only: str) -> None:
    """Measure every format that has points or whose labels come back, or only some of them."""
    source = reader(None, connect=None, state=Path(state), artifacts=None, database=None)

    def current(scene_id: str) -> tuple[SceneScore, Overlay]:
        score = decode(SceneScore, source.record(scene_id))
        return score, decode_overlay(source.overlay(scene_id), scene_id=scene_id, where=state)

    raw: dict[str, Mapping[int, Any]] = {}
    forms: dict[str, list[str]] = {name: [] for name in (*READERS, "openlabel")}
    for form, (export, _) in LABELLERS.items():
        forms[export].append(form)
    forms["openlabel"] = ["openlabel"]
    _tell("format | MB a scene | export, s | points by index | labels as | import, s | back")
    with tempfile.TemporaryDirectory() as folder:
        for export, labels in forms.items():
            if only and export not in only:
                continue
            out = Path(folder) / export
            spent_s = _command(
                *("export", selection, "--format", export, "--out", str(out)),
                *("--state", state, "--bucket", logs),
            )
            scenes = scenes_of(out, format_names=[export])
            sizes = [_size(out / place) / 1e6 for place, _ in scenes]
            told = f"{export} | {min(sizes):.1f} to {max(sizes):.1f} | {spent_s / len(scenes):.1f}"
            share = "no points"
            if export in READERS:
                share = _points(export, out, scenes, current, Path(logs), raw)
            for form in labels or [""]:
                back = _labels(form, out, scenes, current, state, Path(folder)) if form else "- | -"
                _tell(f"{told} | {share} | {form or '-'} | {back}")


def _points(
    form: str,
    out: Path,
    scenes: list[tuple[str, str]],
    current: Current,
    logs: Path,
    raw: dict[str, Mapping[int, Any]],
) -> str:
    """Compare every written point with the raw one of its index; return how many are equal."""
    equal = written = recorded = 0
    for place, scene_id in scenes:
        score, overlay = current(scene_id)
        if score.log_id not in raw:
            raw.clear()
            raw[score.log_id] = raw_clouds(logs / f"{score.log_id}.mcap", score.lidar_topic)
        frames = list(points_of(form, out / place))
        assert len(frames) == len(overlay)
        for stamp_ns, (index, points) in zip(overlay.stamps_ns.tolist(), frames, strict=True):
            cloud = raw[score.log_id][stamp_ns]
            near_m = _ROUNDED_M if form == "mcap" else _EXACT_M
            assert len(np.unique(index)) == len(index)
            equal += int((np.abs(points - cloud[index]) <= near_m).all(axis=1).sum())
            written, recorded = written + len(index), recorded + len(cloud)
    return f"{equal:,} of {written:,} ({recorded:,} raw)"


def _labels(
    form: str,
    out: Path,
    scenes: list[tuple[str, str]],
    current: Current,
    state: str,
    folder: Path,
) -> str:
    """Label, import by the command, and compare the labels of every raw point."""
    labelled: dict[str, list[Labelled]] = {}
    for number, (place, scene_id) in enumerate(scenes):
        random = np.random.default_rng(20 + number)
        if form != "openlabel":
            labelled[scene_id] = LABELLERS[form][1](out / place, random)
            continue
        overlay = current(scene_id)[1]
        clouds = [overlay.points_cm[overlay.points_of(f)] for f in range(len(overlay))]
        seen = [cloud[(cloud != NO_POSITION_CM).any(axis=1)] / 100.0 for cloud in clouds]
        labelled[scene_id] = label_openlabel(out / place, random, seen)
    spent_s = _command(
        *("import-labels", str(out), "--format", form, "--truth", str(folder / f"truth-{form}")),
        *("--state", state),
    )
    same = points = 0
    for scene in read_scenes(out, form_named(form), current):
        overlay = current(scene.scene_id)[1]
        for frame, want in zip(scene.frames, labelled[scene.scene_id], strict=True):
            index = np.arange(len(frame.words))
            if len(want.classes) != len(index):
                placed = overlay.points_cm[overlay.points_of(frame.number)] != NO_POSITION_CM
                index = np.flatnonzero(placed.any(axis=1))
            good = frame.words[index] & 0xFFFF == want.classes
            good &= frame.motion[index] == want.motion
            if want.objects is not None:
                good &= frame.words[index] >> 16 == want.objects
            same, points = same + int(good.sum()), points + len(want.classes)
    return f"{spent_s / len(scenes):.1f} | {same:,} of {points:,}"


def _command(*arguments: str) -> float:
    """Run the command; return the processor time that it took, seconds."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    run = subprocess.run(
        [sys.executable, "-m", "service.cli", *arguments], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    _tell(f"# {time.monotonic() - begun:.1f} s on the clock: {run.stderr.splitlines()[-1]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _size(place: Path) -> int:
    files = [place] if place.is_file() else [each for each in place.rglob("*") if each.is_file()]
    return sum(each.stat().st_size for each in files)


if __name__ == "__main__":
    main(*sys.argv[1:])
