"""Let Label Studio's SDK check the interface, the tasks and the predictions of an export."""

import json
import sys
from pathlib import Path

from label_studio_sdk.label_interface import LabelInterface

folder = Path(sys.argv[1])
interface = LabelInterface((folder / "config.xml").read_text())
interface.validate()
tasks = json.loads((folder / "tasks.json").read_text())
found = []
for task in tasks:
    predictions = task.pop("predictions")
    found.append(
        {
            "task": bool(interface.validate_task(task)),
            "predictions": [bool(interface.validate_prediction(each)) for each in predictions],
        }
    )
json.dump(found, sys.stdout)
