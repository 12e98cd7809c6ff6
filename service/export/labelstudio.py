"""Format `labelstudio`: a task for each scene, with a picture and a question for each track.

Label Studio shows no point clouds: a person judges there which stream is wrong. `config.xml` is the
labelling interface. Pictures are local files below the folder of the export, which the setting
`LABEL_STUDIO_LOCAL_FILES_DOCUMENT_ROOT` names; the project needs a storage of its `images`.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from schemas.attribution import Wrong
from service.curation.selection import Selection
from service.export.format import Format
from service.export.scene import SceneToExport

CHOICES: Final = {
    Wrong.SUPERVISED: "supervised",
    Wrong.SELFSUPERVISED: "self_supervised",
    Wrong.BOTH: "both",
    Wrong.NEITHER: "neither",
}
"""Choice for each attribution, by the names of verdicts."""

MOST_TRACKS: Final = 5
"""Tracks of a scene that are asked about at most: as many as a record gives reasons for."""

IMAGES: Final = "images"
CHOICE: Final = "wrong_"
"""Name of the choice of a track, before its place."""

TRACKS: Final = "track_ids"
"""Key of a task's data: the tracks that are asked about, by place."""


def write_picture(scene: SceneToExport, path: Path) -> None:
    """Write the picture of one scene from above."""
    from service.pictures.scene import draw_scene

    draw_scene(scene.score, scene.overlay).save(path, format="PNG")


def write_tasks(_selection: Selection, scenes: Sequence[SceneToExport], folder: Path) -> None:
    """Write the tasks and the labelling interface."""
    tasks = [task(scene) for scene in scenes]
    text = json.dumps(tasks, indent=1) + "\n"
    (folder / "tasks.json").write_text(text, encoding="utf-8")
    (folder / "config.xml").write_text(interface(), encoding="utf-8")


def task(scene: SceneToExport) -> dict[str, Any]:
    """Return the task of a scene: its data, and the attributions as a prediction."""
    score = scene.score
    headlines = {each.track_id: each.headline for each in score.reasons}
    asked = [each for each in score.tracks[:MOST_TRACKS] if each.track_id in headlines]
    data: dict[str, Any] = {
        "image": f"/data/local-files/?d={quote(f'{IMAGES}/{scene.stem}.png')}",
        "scene_id": score.scene_id,
        "log_id": score.log_id,
        "record_sha256": scene.sha256,
        "score": score.score,
        TRACKS: [each.track_id for each in asked],
        "verdicts": [each.model_dump() for each in scene.verdicts],
    }
    results: list[dict[str, Any]] = []
    for place in range(MOST_TRACKS):
        track = asked[place] if place < len(asked) else None
        said = "" if track is None else headlines[track.track_id]
        data[f"track_{place}"] = said and f"{place + 1}: {said}"  # as numbered on the picture
        if track is None or track.attribution is None:
            continue
        results.append(
            {
                "id": f"track-{track.track_id}",
                "from_name": f"{CHOICE}{place}",
                "to_name": "image",
                "type": "choices",
                "value": {"choices": [CHOICES[track.attribution.wrong]]},
                "score": track.attribution.chance,
            }
        )
    version = score.producers.pipeline_version
    prediction = {"model_version": version, "score": score.score, "result": results}
    return {"data": data, "predictions": [prediction]}


def interface() -> str:
    """Return the labelling interface: the picture, and a choice for each of the first tracks."""
    choices = "".join(
        f'    <Choice value="{each}"/>\n' for each in (*CHOICES.values(), "unsure", "duplicate")
    )
    asked = "".join(
        f'  <Text name="said_{place}" value="$track_{place}"/>\n'
        f'  <Choices name="{CHOICE}{place}" toName="image" choice="single" showInLine="true">\n'
        f"{choices}  </Choices>\n"
        for place in range(MOST_TRACKS)
    )
    return f'<View>\n  <Image name="image" value="$image" zoom="true"/>\n{asked}</View>\n'


LABELSTUDIO: Final = Format(
    name="labelstudio",
    text="Tasks of Label Studio: a picture of each scene, and which stream is wrong by track.",
    ending=".png",
    folder=IMAGES,
    write_scene=write_picture,
    write_all=write_tasks,
)
"""No log is read."""
