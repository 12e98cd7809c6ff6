"""The example notebook has outputs, of every cell and of no particular machine."""

import json
import re

from tests.example_notebook import NOTEBOOK

MAX_BYTES = 500_000


def test_the_notebook_was_executed_whole_and_names_no_path_of_a_machine() -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert len(text) < MAX_BYTES
    cells = [each for each in json.loads(text)["cells"] if each["cell_type"] == "code"]
    assert [each["execution_count"] for each in cells] == list(range(1, len(cells) + 1))
    outputs = [output for each in cells for output in each["outputs"]]
    assert {output["output_type"] for output in outputs} == {"execute_result"}
    assert sum("image/png" in output["data"] for output in outputs) == 1
    shown = [str(output["data"].get("text/plain")) for output in outputs]
    assert [each for each in shown if re.search(r"/(home|root|tmp|work|Users)/", each)] == []
