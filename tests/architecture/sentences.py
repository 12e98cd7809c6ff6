"""The rule for sentences of docstrings, comments on constants, pages and command help.

The first line of a docstring is a verb phrase or a noun phrase, never a question. A sentence has at
most MAX_WORDS words, and none of the words of DENIED, for which the literature has plain ones.
`python -m tests.architecture.sentences [PATH ...]` lists what breaks the rule.
"""

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
CODE: Final = ("schemas", "service", "workers", "deploy")
PAGES: Final = ("*.md", "schemas/*.md", "service/**/*.md", "workers/**/*.md", "deploy/**/*.md")

MAX_WORDS: Final = 30
"""Words of a sentence at most; the rule asks for about 20, and lists need more."""

OPENERS: Final = frozenset(
    {
        "and",
        "as",
        "beside",
        "but",
        "how",
        "if",
        "nobody",
        "so",
        "than",
        "that",
        "what",
        "whatever",
        "when",
        "where",
        "whether",
        "which",
        "who",
        "whoever",
        "whose",
        "why",
    }
)
"""First words of a docstring that begin a question or continue another sentence."""

DENIED: Final = {
    r"anew": "again",
    r"nobody": "no one, or the missing subject",
    r"whoever": "the one who, or a noun",
    r"laid (?:in|into)": "inlined into",
    r"beside": "next to, in addition to",
    r"besides": "in addition to",
    r"likewise": "also, in the same way",
    r"worth a look": "a number, or what it is for",
    r"as (?:it is|they are|it was|they were)\b(?! not)": "unchanged",
    r"told": "reported, given, named",
    r"tells?": "reports, shows, names",
    r"stands? for": "means",
    r"(?:streams?|witness|model|network|sensor) (?:say|says|said)": "labels",
    r"thing by thing": "per object",
    r"learnt from": "trained on",
}
"""Words of the house's own, as patterns, each with what to write instead."""

_DENIED: Final = re.compile(rf"\b(?:{'|'.join(f'(?:{each})' for each in DENIED)})\b", re.IGNORECASE)
_SECTION: Final = re.compile(
    r"^\s*(Args|Attributes|Returns|Raises|Yields|Note|Example|Examples|Source):\s*$", re.MULTILINE
)
_ITEM: Final = re.compile(r"^\s*(?:\*{0,2}\w+\*{0,2}(?: \([^)]*\))?:\s|[-*] |\d+\. |\|)")
_DRAWING: Final = re.compile(r"[\u2500-\u257f]")
_SENTENCE_END: Final = re.compile(r"(?<=[.!?])[\"')]*\s+(?=[A-Z`\"(])|[:;](?=\s)")


@dataclass(frozen=True, slots=True)
class Breach:
    """A sentence that breaks the rule.

    Attributes:
        where: File and line.
        what: The word or count that breaks it, and what to write instead.
        sentence: Its beginning.
    """

    where: str
    what: str
    sentence: str

    def __str__(self) -> str:
        """Return one line for a list."""
        return f"{self.where}: {self.what}: {self.sentence[:90]!r}"


def breaches_of_code(path: Path) -> Iterator[Breach]:
    """Yield the breaches in the docstrings of a module and in the texts below its constants."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    shown = path.relative_to(ROOT).as_posix()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for statement in body:
            if (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            ):
                text = statement.value.value
                where = f"{shown}:{statement.lineno}"
                first = text.strip().split(maxsplit=1)[0].strip("`'\",.:;").lower() if text else ""
                if first in OPENERS:
                    yield Breach(where, f"begins with '{first}'", text.strip())
                yield from _breaches(text, where)


def breaches_of_page(path: Path) -> Iterator[Breach]:
    """Yield the breaches in the prose of a Markdown page: code, tables and links are left out."""
    shown = path.relative_to(ROOT).as_posix()
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    for line in text.splitlines():
        title = re.match(r"#+ (\w+)", line)
        if title and title[1].lower() in OPENERS:
            yield Breach(shown, f"title begins with '{title[1].lower()}'", line)
    yield from _breaches(text, shown)


def breaches_of_text(text: str, where: str) -> Iterator[Breach]:
    """Yield the breaches in a text of the command line.

    Click keeps the lines of a text that begins with a backspace: each unindented one is an item.
    """
    if text.startswith("\b\n"):
        text = re.sub(r"\n(?=\S)", "\n\n", text)
    yield from _breaches(text, where)


def _breaches(text: str, where: str) -> Iterator[Breach]:
    for sentence in _sentences(text):
        for found in _DENIED.finditer(re.sub(r"`[^`]*`", "", sentence)):
            yield Breach(where, f"'{found.group().lower()}'", sentence)
        words = len(sentence.split())
        if words > MAX_WORDS:
            yield Breach(where, f"{words} words", sentence)


def _sentences(text: str) -> Iterator[str]:
    """Yield the sentences; an item of a list, a row and a paragraph end one as a full stop does."""
    text = _SECTION.sub("", re.sub(r"https?://\S+", "URL", text))
    block: list[str] = []
    for line in [*text.splitlines(), ""]:
        if _DRAWING.search(line):
            line = ""
        if not line.strip() or _ITEM.match(line) or line.lstrip().startswith("#"):
            yield from _split(" ".join(block))
            block = []
        if line.lstrip().startswith("|"):
            for cell in line.strip().strip("|").split("|"):
                yield from _split(cell)
        elif line.strip():
            block.append(line.strip())


def _split(block: str) -> Iterator[str]:
    for sentence in _SENTENCE_END.split(block):
        if sentence and sentence.strip():
            yield sentence.strip()


def files_of_code() -> list[Path]:
    """Return the modules whose docstrings are held to the rule."""
    return sorted(
        path
        for room in CODE
        for path in (ROOT / room).rglob("*.py")
        if "__pycache__" not in path.parts
    )


def pages() -> list[Path]:
    """Return the Markdown pages that are held to the rule."""
    return sorted({path for pattern in PAGES for path in ROOT.glob(pattern)})


def main(paths: list[str]) -> int:
    """List the breaches below the paths named, or all, and their number."""
    wanted = [Path(each).resolve() for each in paths]
    found = [
        breach
        for path in [*files_of_code(), *pages()]
        if not wanted or any(path == each or each in path.parents for each in wanted)
        for breach in (breaches_of_page(path) if path.suffix == ".md" else breaches_of_code(path))
    ]
    for breach in found:
        sys.stdout.write(f"{breach}\n")
    sys.stdout.write(f"{len(found)} breaches\n")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
