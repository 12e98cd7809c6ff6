"""Appends every scored scene to `scenes.jsonl`, and resumes after a restart."""

import json
import sys
from pathlib import Path

from service.client import watch_scenes

with Path("scenes.jsonl").open("a+", buffering=1) as file:  # one write per line
    file.seek(0)
    since = max((json.loads(line)["seq"] for line in file), default=0)
    for event in watch_scenes(sys.argv[1:], since=since):
        score = event.score.score if event.score else None  # None: withdrawn
        file.write(json.dumps({"seq": event.seq, "scene": event.scene_id, "score": score}) + "\n")
