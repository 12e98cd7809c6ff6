"""Format `mcap`: an excerpt of the log for each scene, with the overlay, and a layout.

Foxglove, Lichtblick and Rerun open it. The recorded messages are copied byte for byte; ours are on
topics below `/counterpoint`. Files are chunked with a summary and chunk indexes, and place sensors
by transforms, as labelling platforms require.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from schemas.excerpt import ExcerptMessage, LogExcerpt
from service.curation.selection import Selection
from service.errors import UsageError
from service.export.format import Format
from service.export.foxglove_messages import (
    BOXES,
    EVENTS,
    ODOM,
    POINTS,
    boxes,
    events,
    point_cloud,
    pose,
)
from service.export.scene import SceneToExport

LAYOUT: Final = "layout.foxglove.json"

_LAST_FRAME_NS: Final = 100_000_000
"""Time for which the boxes of a scene's last frame are shown, nanoseconds: one revolution."""


def write_scene(scene: SceneToExport, path: Path) -> None:
    """Write the excerpt of one scene.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    excerpt = scene.excerpt()
    scene.opened.write_mcap(
        path,
        _messages(scene, excerpt),
        metadata=[*excerpt.metadata, ("counterpoint.scene", facts_of(scene))],
        attachments=[("scene.json", "application/json", _record_of(scene))],
    )


def write_layout(_selection: Selection, scenes: Sequence[SceneToExport], folder: Path) -> None:
    """Write a layout for Foxglove and Lichtblick: the points in space, and the reasons."""
    lidar = scenes[0].score.lidar_topic if scenes else ""
    (folder / LAYOUT).write_text(json.dumps(layout(lidar), indent=1) + "\n", encoding="utf-8")


def facts_of(scene: SceneToExport) -> dict[str, str]:
    """Return what identifies a scene and gives its score, all as text."""
    score = scene.score
    return {
        "scene_id": score.scene_id,
        "log_id": score.log_id,
        "selection": scene.selection,
        "rank": str(scene.row.rank),
        "score": f"{score.score:.4f}",
        "vehicle": score.vehicle,
        "date": score.date,
        "software_version": score.software_version,
        "reason": score.reasons[0].headline if score.reasons else "",
        "record_sha256": scene.sha256,
        "pipeline_version": score.producers.pipeline_version,
        "verdicts": json.dumps([each.model_dump() for each in scene.verdicts]),
    }


def _record_of(scene: SceneToExport) -> bytes:
    whole = {
        "record": scene.score.model_dump(mode="json"),
        "verdicts": [each.model_dump() for each in scene.verdicts],
    }
    if scene.overlay.lidars:
        # points of these follow those of the lidar of the record: the field `index` counts on
        whole["lidars"] = [
            {
                "topic": each.topic,
                "points": each.points.tolist(),
                "stamps_ns": [str(stamp_ns) for stamp_ns in each.stamps_ns.tolist()],
            }
            for each in scene.overlay.lidars
        ]
    return json.dumps(whole).encode()


def _messages(scene: SceneToExport, excerpt: LogExcerpt) -> Iterator[ExcerptMessage]:
    """Yield the recorded messages, and after each frame of the scene the overlay of it."""
    overlay, score = scene.overlay, scene.score
    stamps = [*overlay.stamps_ns.tolist(), int(overlay.stamps_ns[-1]) + _LAST_FRAME_NS]
    said = False
    for message in excerpt.messages():
        yield message
        if message.cloud is None:
            continue
        at_ns = message.log_time_ns
        if not said:
            yield from events(score, facts=facts_of(scene), log_time_ns=at_ns)
            said = True
        cloud = scene.labelled(message.cloud)
        yield pose(cloud, log_time_ns=at_ns)
        yield point_cloud(cloud, overlay, log_time_ns=at_ns)
        until_ns = stamps[cloud.number + 1]
        yield boxes(cloud, overlay, score, until_ns=until_ns, log_time_ns=at_ns)


def layout(lidar_topic: str) -> dict[str, Any]:
    """Return the layout: 3D with the four colours, and the events as text."""
    space: Mapping[str, Any] = {
        "cameraState": {"perspective": True, "distance": 60, "phi": 50, "thetaOffset": 90},
        "followMode": "follow-pose",
        "followTf": "",
        "scene": {"transforms": {"showLabel": False, "axisScale": 0}},
        "topics": {
            POINTS: {
                "visible": True,
                "pointSize": 3,
                "colorMode": "rgba-fields",
                "colorField": "category",
            },
            BOXES: {"visible": True},
            lidar_topic: {"visible": False},
        },
        "transforms": {f"frame:{ODOM}": {"visible": False}},
    }
    return {
        "configById": {
            "3D!counterpoint": space,
            "RawMessages!counterpoint": {"topicPath": EVENTS, "diffEnabled": False},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 0.5},
        "layout": {
            "first": "3D!counterpoint",
            "second": "RawMessages!counterpoint",
            "direction": "row",
            "splitPercentage": 75,
        },
    }


def need_schemas() -> None:
    """Refuse where the package with Foxglove's schemas is not installed."""
    if find_spec("foxglove_schemas_protobuf") is None:
        raise UsageError(
            "format mcap needs Foxglove's message schemas: install 'counterpoint[export]'"
        )


MCAP: Final = Format(
    name="mcap",
    text="An excerpt of the log for each scene, with the overlay: Foxglove, Lichtblick, Rerun.",
    ending=".mcap",
    write_scene=write_scene,
    write_all=write_layout,
    reads_logs=True,
    check=need_schemas,
)
"""Raw messages byte for byte, points with colours, boxes, events, metadata, and a layout."""
