"""The subscriber that the README shows is the file that tests run, as short as promised."""

import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "deploy" / "examples" / "subscriber.py"
SHOWN = re.compile(r"<!-- deploy/examples/subscriber\.py -->\n```python\n(.*?)```", re.DOTALL)


def test_the_readme_shows_the_example_as_it_is() -> None:
    (shown,) = SHOWN.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert shown == EXAMPLE.read_text(encoding="utf-8")


def test_the_example_has_ten_lines_of_code() -> None:
    aside = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    tokens = tokenize.generate_tokens(io.StringIO(EXAMPLE.read_text(encoding="utf-8")).readline)
    lines = {
        token.start[0]
        for token in tokens
        if token.type not in aside | {tokenize.ENDMARKER} and not token.line.startswith('"""')
    }
    assert len(lines) <= 10
