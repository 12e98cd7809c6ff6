"""Format `parquet`: a table of scenes and a table of their tracks, for notebooks and databases."""

import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from schemas.contradiction import TrackRecord
from service.curation.selection import Selection
from service.errors import UsageError
from service.export.format import Format
from service.export.scene import SceneToExport

SCENES: Final = "scenes.parquet"
TRACKS: Final = "tracks.parquet"

Row = Mapping[str, Any]


def write_tables(selection: Selection, scenes: Sequence[SceneToExport], folder: Path) -> None:
    """Write both tables; a track has the id of its scene.

    Args:
        selection: The selection, whose name is metadata of both.
        scenes: Its scenes.
        folder: Folder for the tables.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    about = {b"counterpoint.selection": selection.name.encode()}
    for name, fields, rows in (
        (SCENES, _scene_fields(pa), [_scene_row(each) for each in scenes]),
        (
            TRACKS,
            _track_fields(pa),
            [_track_row(each, track) for each in scenes for track in each.score.tracks],
        ),
    ):
        table = pa.Table.from_pylist(rows, schema=pa.schema(fields, metadata=about))
        pq.write_table(table, folder / name, compression="zstd")


def need_pyarrow() -> None:
    """Refuse where pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        raise UsageError("format parquet needs pyarrow: install 'counterpoint[predictions]'")


def _scene_fields(pa: Any) -> list[tuple[str, Any]]:
    text, real, whole = pa.string(), pa.float64(), pa.int64()
    return [
        *((name, text) for name in ("scene_id", "log_id", "lidar_topic", "vehicle", "date")),
        *((name, text) for name in ("software_version", "task", "state")),
        ("rank", whole),
        ("score", real),
        ("start", pa.timestamp("ns", tz="UTC")),
        ("end", pa.timestamp("ns", tz="UTC")),
        *((name, whole) for name in ("frames", "points", "tracks")),
        *((name, real) for name in ("compared_share", "contradicting_share", "distance_m")),
        ("odometry", text),
        ("reasons", pa.list_(text)),
        *((name, text) for name in ("supervised", "selfsupervised", "pipeline_version")),
        ("record_sha256", text),
        ("verdicts", text),
    ]


def _scene_row(scene: SceneToExport) -> Row:
    score = scene.score
    shares = score.all_points
    contradicting = sum(shares[name] for name in shares.outcomes if not name.startswith("both_"))
    return {
        "scene_id": score.scene_id,
        "log_id": score.log_id,
        "lidar_topic": score.lidar_topic,
        "vehicle": score.vehicle,
        "date": score.date,
        "software_version": score.software_version,
        "task": score.task,
        "state": score.state.value,
        "rank": scene.row.rank,
        "score": score.score,
        "start": score.start_ns,
        "end": score.end_ns,
        "frames": score.frames,
        "points": score.points,
        "tracks": len(score.tracks),
        "compared_share": score.compared_share,
        "contradicting_share": contradicting,
        "distance_m": score.odometry.distance_m,
        "odometry": score.odometry.state.value,
        "reasons": [reason.headline for reason in score.reasons],
        "supervised": score.producers.supervised,
        "selfsupervised": score.producers.selfsupervised,
        "pipeline_version": score.producers.pipeline_version,
        "record_sha256": scene.sha256,
        "verdicts": json.dumps([each.model_dump() for each in scene.verdicts]),
    }


def _track_fields(pa: Any) -> list[tuple[str, Any]]:
    text, real, whole = pa.string(), pa.float64(), pa.int64()
    return [
        ("scene_id", text),
        ("track_id", whole),
        *((name, text) for name in ("kind", "class_name", "wrong")),
        *((name, real) for name in ("strength", "chance_supervised", "chance_selfsupervised")),
        *((name, real) for name in ("chance_both", "chance_neither", "speed_m_per_s")),
        ("first", pa.timestamp("ns", tz="UTC")),
        ("last", pa.timestamp("ns", tz="UTC")),
        *((name, whole) for name in ("frames", "points")),
        ("strongest", pa.timestamp("ns", tz="UTC")),
        *((name, real) for name in ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m")),
        *((name, real) for name in ("yaw_rad", "range_m")),
        ("headline", text),
        ("verdicts", text),
    ]


def _track_row(scene: SceneToExport, track: TrackRecord) -> Row:
    blamed, best = track.attribution, track.strongest
    headlines = {each.track_id: each.headline for each in scene.score.reasons}
    mine = [each.model_dump() for each in scene.verdicts if each.track_id == track.track_id]
    return {
        "scene_id": scene.score.scene_id,
        "track_id": track.track_id,
        "kind": track.kind,
        "class_name": track.class_name,
        "wrong": blamed.wrong.value if blamed else None,
        "strength": track.strength,
        "chance_supervised": blamed.supervised if blamed else None,
        "chance_selfsupervised": blamed.selfsupervised if blamed else None,
        "chance_both": blamed.both if blamed else None,
        "chance_neither": blamed.neither if blamed else None,
        "speed_m_per_s": track.speed_m_per_s,
        "first": track.first_ns,
        "last": track.last_ns,
        "frames": track.frames,
        "points": track.points,
        "strongest": best.stamp_ns,
        **dict(zip(("x_m", "y_m", "z_m"), best.centre_m, strict=True)),
        **dict(zip(("length_m", "width_m", "height_m"), best.size_m, strict=True)),
        "yaw_rad": best.yaw_rad,
        "range_m": best.range_m,
        "headline": headlines.get(track.track_id),
        "verdicts": json.dumps(mine),
    }


PARQUET: Final = Format(
    name="parquet",
    text="Tables of scores and tracks: one row for each scene, and one for each track.",
    write_all=write_tables,
    check=need_pyarrow,
)
"""Read by pandas, DuckDB, Spark and others."""
