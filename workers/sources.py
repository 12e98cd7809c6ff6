"""Digests of source code, for the versions of the results computed by it."""

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Final

OURS: Final = ("schemas", "workers")
"""Top-level packages whose imports are followed."""

NO_EFFECT_ON_RECORDS: Final = frozenset(
    {
        "schemas.transport.bucket",  # fetches bytes, whose digests the log's plan names
        "schemas.transport.bucket_errors",
        "workers.pictures.scene_pictures",  # keeps images next to a record
        "workers.warmup.jit_warmup",  # compiles loops ahead of time without changing results
        "workers.memory",  # measures
        "workers.stage_timing",  # measures
    }
)
"""Modules that mining imports and no record depends on.

They are in no version, nor are the modules that they alone import."""


FOR_READERS: Final[Mapping[str, frozenset[str]]] = {
    "Field": frozenset({"description"}),
    "Part": frozenset({"text", "source", "licence", "weights"}),
}
"""Keywords of calls, by the name of what is called, whose texts shape no record."""


@cache
def source_digest(*roots: str) -> str:
    """Digest the files of some modules, byte for byte.

    A changed comment changes it: it is the key of compiled code, which is cheap to compile again.

    Args:
        roots: Modules; a package names every module in it, nested packages included.

    Returns:
        Hexadecimal digits of a sha256.

    Raises:
        ModuleNotFoundError: If a root is no module of ours.
    """
    digest = hashlib.sha256()
    for module in sorted(_named(roots)):
        digest.update(module.encode() + b"\0" + _modules()[module].read_bytes() + b"\0")
    return digest.hexdigest()


@cache
def syntax_digest(*roots: str) -> str:
    """Digest the syntax of some modules and of all modules of ours that they import.

    Comments, layout, docstrings and the texts that `FOR_READERS` names do not count. A module that
    is moved or renamed does: its name is part of the syntax of those that import it.

    Args:
        roots: Modules; a package names every module in it.

    Returns:
        Hexadecimal digits of a sha256.

    Raises:
        ModuleNotFoundError: If a root is no module of ours.
    """
    return digest_of(sources(*roots))


def digest_of(modules: frozenset[str]) -> str:
    """Digest the names and the syntax of these modules, and of none that they import."""
    digest = hashlib.sha256()
    for module in sorted(modules):
        digest.update(module.encode() + b"\0" + _read(module).digest)
    return digest.hexdigest()


def sources(*roots: str) -> frozenset[str]:
    """Return the modules whose syntax `syntax_digest` digests, imports in functions included.

    Raises:
        ModuleNotFoundError: If a root is no module of ours.
    """
    found, waiting = set[str](), _named(roots)
    while waiting:
        module = waiting.pop()
        if any(_lies_in(module, each) for each in NO_EFFECT_ON_RECORDS):
            continue
        found.add(module)
        waiting |= _read(module).imports - found
    return frozenset(found)


@dataclass(frozen=True, slots=True)
class _Module:
    """The digest of a module's syntax, and the modules of ours that it imports."""

    digest: bytes
    imports: frozenset[str]


@cache
def _modules() -> Mapping[str, Traversable]:
    """Return the file of every module of ours, by the module's dotted name."""
    return {name: file for root in OURS for name, file in _below(root, resources.files(root))}


def _below(package: str, folder: Traversable) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        stem = entry.name.removesuffix(".py")
        if entry.is_dir():
            yield from _below(f"{package}.{entry.name}", entry)
        elif stem != entry.name:
            yield package if stem == "__init__" else f"{package}.{stem}", entry


def _named(roots: Iterable[str]) -> set[str]:
    named = set[str]()
    for root in roots:
        within = {module for module in _modules() if _lies_in(module, root)}
        if not within:
            raise ModuleNotFoundError(f"no module {root} to digest")
        named |= within
    return named


def _lies_in(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


@cache
def _read(module: str) -> _Module:
    syntax = _Syntax()
    syntax.take(ast.parse(_modules()[module].read_bytes()))
    digest = hashlib.sha256("\0".join(syntax.words).encode("utf-8", "surrogatepass")).digest()
    with_packages = {
        ".".join(parts[: count + 1])
        for parts in (name.split(".") for name in syntax.imported)
        for count in range(len(parts))
    }
    return _Module(digest, frozenset(with_packages & _modules().keys()) - {module})


class _Syntax:
    """A syntax tree as words, and the names that it imports.

    `ast.dump` would differ from one release of Python to the next, which adds new, empty fields.
    """

    def __init__(self) -> None:
        self.words: list[str] = []
        self.imported: set[str] = set()

    def take(self, node: ast.AST) -> None:
        """Add a node and its children."""
        words = self.words
        if isinstance(node, ast.Import):
            self.imported.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            self.imported.add(node.module)
            self.imported.update(f"{node.module}.{alias.name}" for alias in node.names)
        words.append(type(node).__name__)
        for name in node._fields:
            if name == "ctx":  # follows from the place of the node
                continue
            value = getattr(node, name, None)
            if value is None or value == []:
                continue
            words.append(name)
            if isinstance(value, ast.AST):
                self.take(value)
            elif isinstance(value, list):
                self._take_all(node, value)
            else:
                words.append(repr(value))
        words.append(")")

    def _take_all(self, node: ast.AST, values: list[object]) -> None:
        for value in values:
            if not isinstance(value, ast.AST):
                self.words.append(repr(value))
            elif not (_is_docstring(value) or _is_description(node, value)):
                self.take(value)
        self.words.append("]")


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and _is_text(node.value)


def _is_description(call: ast.AST, node: ast.AST) -> bool:
    return (
        isinstance(node, ast.keyword)
        and _is_text(node.value)
        and isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and node.arg in FOR_READERS.get(call.func.id, ())
    )


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
