"""Verbs on one log: `inspect` shows its content, `score` mines it without a bus."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import unquote

import typer

from schemas.transport.bucket import Bucket, open_bucket, open_object
from schemas.transport.recordings import recording_of
from schemas.work import Recording
from service.cli.option_groups import MiningOptions, grouped
from service.cli.options import (
    BucketRoot,
    Config,
    Force,
    Json,
    Predictions,
    ShardSeconds,
    settings_for,
)
from service.cli.output import json_line, listing, progress, remark
from service.cli.report import first_of, said_of_damage, say_inspected, say_judged, say_open
from service.errors import NothingFoundError
from service.output_files import need_folder, save_picture

if TYPE_CHECKING:
    from workers.mine import MinedRecord

LogUrl = Annotated[str, typer.Argument(help="URL or path of one .mcap file; any part of a split.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint inspect s3://fleet/car-7/2026-11-20/drive.mcap")(inspect)
    app.command(epilog="counterpoint score logs/car-7/2026-11-20/drive.mcap --json")(score)


def inspect(
    url: LogUrl,
    verify: Annotated[bool, typer.Option(help="Read every chunk and every cloud.")] = False,
    json: Json = False,
    bucket: BucketRoot = None,
    predictions: Predictions = None,
    config: Config = None,
) -> None:
    """Show the content of a log, from its index; with --verify from every chunk."""
    from workers.errors import LogUnusableError
    from workers.ingest.inspect import inspect_recording
    from workers.model_answer import read_answer

    supervised = "recorded" if predictions else None
    settings = settings_for(config, bucket=bucket, predictions=predictions, supervised=supervised)
    store, recording = locate(url, root_url=settings.bucket)
    with progress() as bar:
        task = bar.add_task("reading", total=None)
        report = inspect_recording(
            store,
            recording,
            settings.mining(),
            verify=verify,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    answer, problem = None, ""
    try:
        answer = read_answer(store, recording, settings.mining())
    except LogUnusableError as error:  # its content is shown all the same
        problem = str(error)
    if json:
        json_line(report.model_copy(update={"answer": answer}))
        return
    say_inspected(report.model_dump(mode="json", exclude={"answer"}))
    if problem:
        remark(f"the model's answer cannot be read: {problem}")
    if answer is not None:
        remark(f"the model's answer: {answer.sentence}")
        for fault in answer.problems:
            remark(f"the model's answer: {fault}")


@grouped
def score(
    *,
    url: LogUrl,
    json: Json = False,
    bucket: BucketRoot = None,
    shard_seconds: ShardSeconds = None,
    mining: MiningOptions,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder for a picture of each scene.")
    ] = None,
    config: Config = None,
    force: Force = False,
) -> None:
    """Mine one log on this machine, without a bus: one scene after the other."""
    from workers.score import score_recording

    if pictures is not None:
        need_folder(pictures, option="--pictures")
    settings = settings_for(
        config,
        bucket=bucket,
        shard_seconds=shard_seconds,
        **mining.flags(),
    )
    store, recording = locate(url, root_url=settings.bucket)
    scored = []
    with progress() as bar:
        task = bar.add_task(f"mining {recording.log_id}", total=None)
        for row in score_recording(
            store,
            recording,
            settings.mining(),
            on_shard=lambda done, total: bar.update(task, completed=done, total=total),
            on_damage=lambda damage: remark(said_of_damage(damage)),
            on_scene=partial(_draw, folder=pictures, force=force)
            if pictures
            else lambda mined: None,
            on_unread_labels=lambda topic: remark(
                f"this log has recorded labels on {topic}; compare them by --supervised recorded"
            ),
        ):
            if json:
                json_line(row)
            scored.append(row)
    if not json:
        listing(
            recording.log_id,
            ("score", "state", "frames", "reasons", "scene"),
            (
                (
                    (s.score, s.state.value, s.frames, len(s.reasons) or None, s.scene_id),
                    first_of([each.headline for each in s.reasons]),
                )
                for s in scored
            ),
        )
    say_judged(scored)
    say_open(scored)


def _draw(mined: "MinedRecord", *, folder: Path, force: bool) -> None:
    from schemas.transport.overlay_codec import decode_overlay
    from service.pictures.scene import draw_scene

    score = mined.score
    name = score.scene_id.removeprefix(f"{score.log_id}/").replace("/", "-")
    path = folder / f"{name}.png"
    picture = draw_scene(score, decode_overlay(mined.overlay))
    save_picture(picture, path, option="--pictures", force=force)
    remark(f"picture: {path}")


def locate(url: str, *, root_url: str) -> tuple[Bucket, Recording]:
    """Find the recording of an object's URL, with all parts of a split one.

    The bucket is `root_url` where the object lies in it, else the one that `open_object` derives.

    Raises:
        NothingFoundError: If no such object exists.
    """
    absolute, root = _absolute(url), _absolute(root_url).rstrip("/") + "/" if root_url else ""
    if root and absolute.startswith(root):
        bucket, key = open_bucket(root_url), unquote(absolute.removeprefix(root))
    else:
        bucket, key = open_object(url)
    try:
        return bucket, recording_of(key, bucket.list(prefix=key.rpartition("/")[0]))
    except LookupError:
        raise NothingFoundError(f"no such log: {url}") from None


def _absolute(url: str) -> str:
    return url if "://" in url else Path(url).absolute().as_uri()
