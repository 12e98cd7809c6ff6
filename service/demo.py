"""`counterpoint demo`: a small simulated fleet, mined as any bucket is, then looked at."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.progress import Progress

from schemas.overlay import decode_overlay
from service.config import Settings, load_settings
from service.demo_planted import DemoScene, beside_truth
from service.demo_retrieval import RankingFound, found_in
from service.embedded import run_embedded
from service.picture import draw_scene
from service.reading import StateReader
from service.status import Status

PICTURES: Final = 3


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What came of a demo.

    Attributes:
        status: How mining went.
        scenes: All of them, best first, each beside what was planted in it.
        pictures: Of the best ones.
        found: How well rankings find those in which a failure was planted.
    """

    status: Status
    scenes: list[DemoScene]
    pictures: list[Path]
    found: list[RankingFound]


def demo_settings(
    out: Path, *, workers: int, log_format: str | None = None, log_level: str | None = None
) -> Settings:
    """Settings of a demo in this folder: nothing of the user's fleet is read or written.

    Raises:
        UsageError: If a value is impossible.
    """
    return load_settings(
        bucket=str(out / "fleet" / "logs"),
        state=out / "state",
        artifacts="",
        database="",
        include=(),
        exclude=(),
        lidar_topic="",
        workers=workers,
        supervised="recorded",
        log_format=log_format,
        log_level=log_level,
    )


def run_demo(
    out: Path,
    *,
    settings: Settings,
    remark: Callable[[str], None],
    progress: Callable[[], AbstractContextManager[Progress]],
    now_s: float,
) -> DemoResult:
    """Simulate street logs, mine them with `run --once`, rank the scenes, draw the best.

    The model that ran on the simulated cars is right but for a few mistakes that were put in; the
    self-supervised stream has never seen them.

    Args:
        out: Folder for everything; what an earlier demo left there is replaced.
        settings: As `demo_settings` makes them for this folder.
        remark: Told what happens.
        progress: Makes a progress bar.
        now_s: Time, for rates in the status.

    Returns:
        What came of it.
    """
    from workers.simulation.demo import DEMO_FRAMES, make_demo_fleet

    bucket, state, pictures = out / "fleet", out / "state", out / "pictures"
    if state.exists():
        remark(f"replacing the earlier demo in {out}")
    for folder in (bucket, state, pictures):
        shutil.rmtree(folder, ignore_errors=True)
    pictures.mkdir(parents=True)

    with progress() as bar:
        task = bar.add_task("simulating street logs", total=DEMO_FRAMES)
        logs = make_demo_fleet(
            bucket, processes=settings.workers, progress=lambda: bar.advance(task)
        )
    planted = [each.kind.value.replace("_", " ") for log in logs for each in log.planted.failures]
    remark(
        f"{len(logs)} simulated logs; the model on these cars was made to err {len(planted)} times "
        f"({', '.join(sorted(set(planted)))}). Mining them takes a few minutes."
    )
    with progress() as bar:
        task = bar.add_task("mining", total=None)
        status = run_embedded(
            settings,
            once=True,
            on_ready=remark,
            on_progress=lambda what, done, total: bar.update(
                task, description=what, completed=done, total=total
            ),
        )
    reader = StateReader(settings, now_s=now_s)
    ranking = reader.top()
    records = {row.scene_id: reader.scene(row.scene_id) for row in ranking}
    scenes = beside_truth(
        ranking,
        records,
        bucket / "truth",
        overlay_of=lambda scene_id: decode_overlay(reader.overlay(scene_id)),
    )
    drawn: list[Path] = []
    worth = [each for each in scenes if each.row.twin_of is None and each.record.score > 0]
    for scene in worth[:PICTURES]:
        path = pictures / scene.file_name
        overlay = decode_overlay(reader.overlay(scene.row.scene_id))
        draw_scene(scene.record, overlay).save(path)
        drawn.append(path)
    return DemoResult(status, scenes, drawn, found_in(scenes))
