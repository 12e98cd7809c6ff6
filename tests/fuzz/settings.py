"""Reads thousands of odd settings: `python -m tests.fuzz.settings --examples 20000`.

Files, variables and flags are made by hypothesis from seeds: real names with odd values, odd names,
damaged TOML. Each set is accepted, or refused in one sentence without a secret.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, Final

from hypothesis import strategies as st

from schemas.visible import visible
from service.errors import UsageError
from service.settings.config import Settings, read_settings
from service.settings.sources import leaves
from tests.fuzz.parts import run_parts

SLOW_S: Final = 5.0
"""Time after which reading counts as a hang, seconds."""

MOST_MB: Final = 700
MOST_SENTENCE: Final = 20_000
"""Characters of a refusal; it names every setting that is wrong."""

SECRET: Final = "s3cr3t-of-a-database"  # noqa: S105
NAMES: Final = tuple(sorted(leaves(Settings)))
VALUES: Final = (
    "",
    "true",
    "-1",
    "1e400",
    "nan",
    "9" * 400,
    "[",
    '["a", 1]',
    "tcp/127.0.0.1:7447",
    f"postgresql://app:{SECRET}@host/db",
    "postgresql://[::1",
    "s3://fleet",
    "x" * 5000,
    "\x00",
    "\ud800".encode("utf-8", "surrogatepass").decode("utf-8", "replace"),
)


def main() -> int:
    """Read, and say how it went; 1 if a set was neither accepted nor refused."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.settings")
    asked.add_argument("--examples", type=int, default=20_000, help="how many sets")
    asked.add_argument("--seed", type=int, default=0, help="of the first part")
    how = asked.parse_args()
    ends, failures = read_many(how.examples, first_seed=how.seed)
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    for end, count in sorted(ends.items()):
        sys.stdout.write(f"{end:10s} {count:7d}\n")
    sys.stdout.write(f"peak memory {megabytes} MB\n")
    for what, first in failures.items():
        sys.stdout.write(f"{what}\n    first: {first[:500]}\n")
    return int(bool(failures) or megabytes > MOST_MB)


def read_many(examples: int, *, first_seed: int = 0) -> tuple[Counter[str], dict[str, str]]:
    """Read so many sets of settings.

    Returns:
        How they ended, and what went wrong with the first set that it went wrong with.
    """
    ends: Counter[str] = Counter()
    failures: dict[str, str] = {}
    kept = dict(os.environ)
    with tempfile.TemporaryDirectory(prefix="settings-") as folder:
        file = Path(folder) / "counterpoint.toml"
        file.touch(0o600)
        try:
            run_parts(
                sets(),
                lambda made: _read(file, made, ends, failures),
                examples=examples,
                first_seed=first_seed,
            )
        finally:
            os.environ.clear()
            os.environ.update(kept)
    return ends, failures


def sets() -> st.SearchStrategy[tuple[bytes, dict[str, str], dict[str, Any]]]:
    """Make sets: bytes of a file, variables, and flags."""
    names = st.one_of(st.sampled_from(NAMES), st.text("abc_.-", min_size=1, max_size=12))
    texts = st.one_of(st.sampled_from(VALUES), st.text(max_size=60), st.integers().map(str))
    lines = st.builds(
        lambda name, value, quoted: f'{name} = "{value}"' if quoted else f"{name} = {value}",
        *(names, texts, st.booleans()),
    )
    files = st.one_of(
        st.lists(lines, max_size=5).map(lambda made: "\n".join(made).encode("utf-8", "replace")),
        st.binary(max_size=200),
    )
    variables = st.dictionaries(
        names.map(lambda name: "COUNTERPOINT_" + name.replace(".", "__").upper()),
        texts.filter(lambda text: "\x00" not in text),
        max_size=3,
    )
    values = st.one_of(
        texts, st.integers(), st.floats(), st.booleans(), st.lists(texts, max_size=3)
    )
    flags = st.dictionaries(
        st.sampled_from(NAMES).filter(lambda name: "." not in name), values, max_size=3
    )
    return st.tuples(files, variables, flags)


def _read(
    file: Path,
    made: tuple[bytes, dict[str, str], dict[str, Any]],
    ends: Counter[str],
    failures: dict[str, str],
) -> None:
    content, variables, flags = made
    file.write_bytes(content)
    for name in [name for name in os.environ if name.startswith("COUNTERPOINT_")]:
        del os.environ[name]
    began_s = time.monotonic()
    try:
        os.environ.update(variables)
        read_settings(config=file, **flags)
        end, words = "accepted", ""
    except UsageError as error:
        end, words = "refused", visible(str(error))  # as the command prints it
    except Exception as error:  # noqa: BLE001
        end, words = "failed", ""
        failures.setdefault(f"{type(error).__name__}: {error}"[:300], repr(made))
    ends[end] += 1
    if time.monotonic() - began_s > SLOW_S:
        failures.setdefault("it took too long", repr(made))
    if SECRET in words:
        failures.setdefault(f"a secret is told: {words[:300]}", repr(made))
    if "\n" in words or len(words) > MOST_SENTENCE:
        failures.setdefault(f"no sentence: {words[:300]!r}", repr(made))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
