"""Run of `counterpoint demo`: a small simulated fleet, mined like any bucket, ranked and drawn."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.progress import Progress

from service.api.reader import overlay_of
from service.api.state_reader import StateReader
from service.curation.ranking import has_reason
from service.curation.scene_names import short_names
from service.curation.status import Status
from service.demo.planted import DemoScene, with_truth
from service.demo.retrieval import RankingFound, found_in
from service.embedded import run_embedded
from service.errors import UsageError
from service.output_files import need_folder, save_picture
from service.pictures.scene import draw_scene
from service.pictures.title import title_of
from service.settings.config import Settings, load_settings
from service.store.engine import DATABASE_NAME

PICTURES: Final = 3

_MARK: Final = ".counterpoint-demo"
"""Name of the file that marks a folder of a demo, which the next demo may replace."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """Results of a demo.

    Attributes:
        status: Status of the ledger after mining.
        scenes: All scenes, best first, each with its planted failures.
        pictures: Pictures of the best ones.
        found: Retrieval quality of the rankings for planted failures.
        chosen: Ids of the distinct scenes with a reason, which a large enough selection takes
            first.
    """

    status: Status
    scenes: list[DemoScene]
    pictures: list[Path]
    found: list[RankingFound]
    chosen: frozenset[str]


def demo_settings(
    out: Path, *, workers: int, log_format: str | None = None, log_level: str | None = None
) -> Settings:
    """Return settings for a demo in this folder, which never touch data of the user's fleet.

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
    force: bool = False,
) -> DemoResult:
    """Simulate street logs, mine them with `run --once`, rank the scenes, draw the best.

    The model on the simulated cars is right except for a few planted mistakes; the self-supervised
    stream was not trained on them.

    Args:
        out: Folder for everything; the output of an earlier demo there is replaced.
        settings: Result of `demo_settings` for this folder.
        remark: Called with a sentence at each step.
        progress: Makes a progress bar.
        now_s: Time, for rates in the status.
        force: Replace folders there even if no demo made them.

    Returns:
        Results of the demo.

    Raises:
        UsageError: If the folder cannot be written, or a folder to replace is of no demo.
    """
    from workers.lab.simulation.output.demo import DEMO_FRAMES, make_demo_fleet

    bucket, pictures = _begin_in(out, remark=remark, force=force)

    with progress() as bar:
        task = bar.add_task("simulating street logs", total=DEMO_FRAMES)
        logs = make_demo_fleet(
            bucket, processes=settings.workers, progress=lambda: bar.advance(task)
        )
    planted = [each.kind.value.replace("_", " ") for log in logs for each in log.planted.failures]
    remark(
        f"{len(logs)} simulated logs; the model on these cars has {len(planted)} planted failures "
        f"({', '.join(sorted(set(planted)))}). Mining them takes a few minutes."
    )
    with progress() as bar:
        task = bar.add_task("mining", total=None)
        status = run_embedded(
            settings,
            once=True,
            remark=remark,
            on_progress=lambda what, done, total: bar.update(
                task, description=what, completed=done, total=total
            ),
        )
    reader = StateReader(settings, now_s=now_s)
    ranking = reader.top()
    records = {row.scene_id: reader.scene(row.scene_id) for row in ranking}
    scenes = with_truth(
        ranking,
        records,
        bucket / "truth",
        overlay_of=lambda scene_id: overlay_of(reader, scene_id),
    )
    drawn: list[Path] = []
    names = short_names(ranking)
    worth = [each for each in scenes if each.row.twin_of is None and has_reason(each.row)]
    for scene in worth[:PICTURES]:
        path = pictures / scene.file_name
        overlay = overlay_of(reader, scene.row.scene_id)
        title = title_of(scene.record, rank=scene.row.rank, name=names[scene.row.scene_id])
        picture = draw_scene(scene.record, overlay, title=title)
        save_picture(picture, path, option="--out", force=force)
        drawn.append(path)
    chosen = frozenset(each.row.scene_id for each in worth)
    return DemoResult(status, scenes, drawn, found_in(scenes), chosen)


def _begin_in(out: Path, *, remark: Callable[[str], None], force: bool) -> tuple[Path, Path]:
    """Empty the folders of a demo, and return those of its fleet and of its pictures.

    Raises:
        UsageError: If the folder cannot be written, or a folder in it is of no demo.
    """
    folders = bucket, state, pictures = out / "fleet", out / "state", out / "pictures"
    there = [folder for folder in folders if folder.exists()]
    # An earlier version left no mark, but a ledger.
    is_of_a_demo = (out / _MARK).is_file() or (
        bucket.is_dir() and (state / DATABASE_NAME).is_file()
    )
    if there and not is_of_a_demo and not force:
        raise UsageError(
            f"--out: {there[0]} exists, and no demo made it: name another folder, or replace it "
            "with --force"
        )
    need_folder(out, option="--out")
    (out / _MARK).touch()
    if there:
        remark(f"replacing the earlier demo in {out}")
    for folder in there:
        shutil.rmtree(folder, ignore_errors=True)
    pictures.mkdir(exist_ok=True)
    return bucket, pictures
