"""Sources of settings: a file, the environment and flags, merged by precedence."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from schemas.runtime.named_file import read_named_file
from schemas.visible import visible
from service.settings.hidden_passwords import in_sentence

PREFIX: Final = "COUNTERPOINT_"
CONFIG_VARIABLE: Final = f"{PREFIX}CONFIG"
NOT_OURS: Final = frozenset({f"{PREFIX}REFERENCE"})
"""Variables with our prefix that are no settings: the tests' folder of real logs."""

_OF_KUBERNETES: Final = re.compile(
    r"_SERVICE_(HOST|PORT(_\w+)?)|_PORT(_\d+_(TCP|UDP|SCTP)(_(PROTO|PORT|ADDR))?)?$"
)
"""Endings of the variables that Kubernetes sets in pods for a service named `counterpoint…`."""

_FLAG_NAMES: Final = {
    "grid.shard_s": "shard_seconds",
    "grid.warmup_s": "warmup_seconds",
    "pictures": "keep_pictures",  # of no verb so far: `--pictures` is a folder to draw into
}
"""Flags whose names differ from their setting's."""

Kind: TypeAlias = Literal["default", "preset", "file", "variable", "flag"]


@dataclass(frozen=True, slots=True)
class Written:
    """A value in a source.

    Attributes:
        kind: Kind of the source.
        where: The flag, the variable, or the file.
        setting: Dotted name of the setting.
        value: Value in the source, not checked.
    """

    kind: Kind
    where: str
    setting: str
    value: Any

    @property
    def origin(self) -> str:
        """Source of the value, for a table."""
        return f"{self.where}:{self.setting}" if self.kind == "file" else self.where

    def quoted(self, value: str) -> str:
        """Format the setting and a value in the syntax of its source."""
        if self.kind == "flag":
            return f"{self.where} {value}"
        if self.kind == "variable":
            return f"{self.where}={value}"
        return f"{self.where}: {self.setting} = {value}"


def leaves(model: type[BaseModel], prefix: str = "") -> dict[str, FieldInfo]:
    """Return every setting of a model by its dotted name, with those of its tables."""
    found: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        table = field.annotation
        if isinstance(table, type) and issubclass(table, BaseModel):
            found |= leaves(table, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = field
    return found


def variable_of(setting: str) -> str:
    """Return the environment variable of a setting."""
    return PREFIX + setting.upper().replace(".", "__")


def flag_of(setting: str) -> str:
    """Return the flag of a setting, for the verbs that have one."""
    return "--" + _FLAG_NAMES.get(setting, setting).replace("_", "-")


def lay(
    known: Mapping[str, FieldInfo],
    *,
    file: Path | None,
    environ: Mapping[str, str],
    flags: Mapping[str, object],
) -> tuple[dict[str, Written], list[str]]:
    """Merge flags over variables over the file.

    Args:
        known: All settings by their dotted names.
        file: TOML; None: there is none.
        environ: Variables of the process.
        flags: By the setting's or the flag's own name, underscores for dashes; None: not given.

    Returns:
        The deciding value of each setting in any source, and one sentence for each invalid name.
    """
    problems: list[str] = []
    laid: dict[str, Written] = {}
    for layer in (
        _of_file(file, known, problems),
        _of_environment(environ, known, problems),
        _of_flags(flags),
    ):
        laid |= {written.setting: written for written in layer}
    problems += [
        f"{written.quoted(visible(in_sentence(written.value)))}: "
        "must be UTF-8 text without a NUL character"
        for written in laid.values()
        if not _can_be_passed_on(written.value)
    ]
    return laid, problems


def nested(laid: Mapping[str, Written]) -> dict[str, Any]:
    """Nest dotted names into tables, as a model takes them."""
    values: dict[str, Any] = {}
    for setting, written in laid.items():
        *tables, name = setting.split(".")
        at = values
        for table in tables:
            at = at.setdefault(table, {})
        at[name] = written.value
    return values


def _of_file(
    file: Path | None, known: Mapping[str, FieldInfo], problems: list[str]
) -> Iterator[Written]:
    if file is None:
        return
    try:
        content = tomllib.loads(read_named_file(file).decode("utf-8"))
    except OSError as error:
        problems.append(f"cannot read the settings file: {error.strerror} ({file})")
        return
    except (
        ValueError,
        RecursionError,
    ) as error:  # also a number of 5,000 digits, or 1,000 brackets
        problems.append(f"the settings file is not TOML: {error} ({file})")
        return
    tables = {setting.rpartition(".")[0] for setting in known}
    for setting, value in _flat(content, tables):
        if setting in known:
            if isinstance(value, bool) and known[setting].annotation is not bool:
                problems.append(f"{file}: {setting} = {str(value).lower()}: is not a boolean")
            else:
                yield Written("file", str(file), setting, value)
        elif setting in tables:
            problems.append(f"{file}: {setting} is a table: write [{setting}] and its keys below")
        else:
            problems.append(f"{file}: unknown setting {setting}{_nearest(setting, known)}")


def _of_environment(
    environ: Mapping[str, str], known: Mapping[str, FieldInfo], problems: list[str]
) -> Iterator[Written]:
    variables = {variable_of(setting): setting for setting in known}
    for name, value in sorted(environ.items()):
        if name in variables:
            yield Written("variable", name, variables[name], value)
        elif name.upper().startswith(PREFIX) and not _is_known(name):
            near = _nearest(name.upper(), (CONFIG_VARIABLE, *variables))
            problems.append(f"unknown variable {name}{near}")


def _can_be_passed_on(value: object) -> bool:
    """Return true if stores, databases and file systems accept a text."""
    if isinstance(value, list | tuple):
        return all(map(_can_be_passed_on, value))
    if not isinstance(value, str | Path):
        return True
    text = str(value)
    return "\0" not in text and not any("\ud800" <= char <= "\udfff" for char in text)


def _is_known(name: str) -> bool:
    ending = name.removeprefix(PREFIX.rstrip("_"))
    return name in {CONFIG_VARIABLE, *NOT_OURS} or bool(_OF_KUBERNETES.search(ending))


def _of_flags(flags: Mapping[str, object]) -> Iterator[Written]:
    settings = {flag: setting for setting, flag in _FLAG_NAMES.items()}
    for name, given in flags.items():
        value = given.model_dump() if isinstance(given, BaseModel) else given
        if value is None:
            continue
        named = settings.get(name, name)
        each = {f"{named}.{key}": v for key, v in value.items()} if isinstance(value, dict) else {}
        for setting, leaf in (each or {named: value}).items():
            yield Written("flag", flag_of(setting), setting, leaf)


def _flat(
    content: Mapping[str, Any], tables: set[str], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, dict) and (f"{prefix}{key}" in tables or value):
            yield from _flat(value, tables, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _nearest(name: str, known: Mapping[str, object] | tuple[str, ...]) -> str:
    near = [each for each in known if each.startswith((f"{name}.", f"{name}__"))]  # a table
    near = near or get_close_matches(name, list(known), n=1)
    if not near:  # a key that stands in the wrong table, or in none
        near = [each for each in known if each.rpartition(".")[2] == name.rpartition(".")[2]]
    return f"; did you mean {near[0]}?" if near else "; `counterpoint config` lists them all"
