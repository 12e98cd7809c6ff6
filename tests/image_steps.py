"""The steps of deploy/Dockerfile, run one by one in a clean root, where no container engine is.

    python -m tests.image_steps FOLDER --target service [--mount /folder/of/wheels]

The root of the base image is Debian's own, by debootstrap, with Debian's Python of the same
version. Each further stage is a copy of the stage that it names. Needs root, debootstrap, and the
package index of this machine's pip, whose settings the build sees.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

PROJECT: Final = Path(__file__).parents[1]
DOCKERFILE: Final = PROJECT / "deploy" / "Dockerfile"
SUITE: Final = "bookworm"
BASE_PACKAGES: Final = "ca-certificates,python3,python3-venv"
PIP_FILES: Final = (Path("/etc/pip.conf"), Path.home() / ".config/pip/pip.conf")
SHELL: Final = ("/bin/sh", "-c")


@dataclass(slots=True)
class Stage:
    """One stage of the file, as far as it was run.

    Attributes:
        root: Its file system.
        env: Its variables.
        workdir: Folder of its commands.
        user: User of its commands, `uid:gid`.
        command: What starts, entry point and arguments.
        health: Command of the health check.
    """

    root: Path
    env: dict[str, str] = field(default_factory=dict)
    workdir: str = "/"
    user: str = "0:0"
    entry: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)
    health: list[str] = field(default_factory=list)

    def run(self, words: Sequence[str], *, env: dict[str, str] | None = None) -> list[str]:
        """Return the command that runs in this root with its variables, folder and user."""
        inside = " ".join(shlex.quote(each) for each in words)
        variables = [f"{name}={value}" for name, value in (self.env | (env or {})).items()]
        return [
            *("chroot", f"--userspec={self.user}", str(self.root)),
            *("/usr/bin/env", "-i", *variables),
            *(*SHELL, f"cd {shlex.quote(self.workdir)} && exec {inside}"),
        ]


def instructions(text: str) -> Iterator[tuple[str, str]]:
    """Yield the instructions of a Dockerfile with their arguments, on one line each."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    for line in re.sub(r"\\\n\s*", " ", "\n".join(lines)).splitlines():
        if line.strip():
            name, _, rest = line.strip().partition(" ")
            yield name.upper(), rest.strip()


def build(target: str, folder: Path, *, args: dict[str, str], mounts: Sequence[Path] = ()) -> Stage:
    """Run the steps of all stages up to a target, each stage in a folder of its name.

    Args:
        target: Name of the stage.
        folder: Folder of the roots; stages that are there are made again.
        args: Values of `ARG`, over the defaults of the file.
        mounts: Folders of this machine that the steps may read, such as those of wheels.

    Raises:
        subprocess.CalledProcessError: If a step fails.
    """
    stages: dict[str, Stage] = {}
    known: dict[str, str] = {}
    stage: Stage | None = None
    for name, rest in instructions(DOCKERFILE.read_text(encoding="utf-8")):
        if name == "ARG":
            key, _, value = rest.partition("=")
            known[key] = args.get(key, value)
            continue
        if name == "FROM":
            if target in stages:
                break
            base, _, called = rest.partition(" AS ")
            stage = stages[called] = _begin(folder / called, stages.get(base))
            continue
        assert stage is not None
        if name == "RUN":
            _run(stage, rest, known, mounts)
        else:
            _step(stage, name, rest, stages)
    return stages[target]


def _begin(root: Path, base: Stage | None) -> Stage:
    _remove(root)
    if base is None:
        clean = root.parent / "clean"
        if not (clean / "usr/bin/python").exists():
            _remove(clean)
            packages = f"--include={BASE_PACKAGES}"
            _do(["debootstrap", "--variant=minbase", packages, SUITE, str(clean)])
            (clean / "usr/bin/python").symlink_to("python3")
        base = Stage(clean, {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"})
    _do(["cp", "-a", "--reflink=auto", str(base.root), str(root)])
    return Stage(root, dict(base.env), base.workdir, base.user, base.entry, base.command)


def _run(stage: Stage, rest: str, known: dict[str, str], mounts: Sequence[Path]) -> None:
    command = re.sub(r"^(--\S+\s+)+", "", rest)
    words = json.loads(command) if command.startswith("[") else [*SHELL, command]
    with _pip_of_this_machine(stage.root, mounts) as env:
        _do(stage.run(words, env=known | env))


def _step(stage: Stage, name: str, rest: str, stages: dict[str, Stage]) -> None:
    match name:
        case "COPY":
            _copy(stage, rest, stages)
        case "ENV":
            for key, value in (each.split("=", 1) for each in shlex.split(rest)):
                stage.env[key] = re.sub(r"\$(\w+)", lambda each: stage.env[each[1]], value)
        case "WORKDIR":
            stage.workdir = rest
            (stage.root / rest.lstrip("/")).mkdir(parents=True, exist_ok=True)
        case "USER":
            stage.user = rest
        case "ENTRYPOINT":
            stage.entry = json.loads(rest)
        case "CMD":
            stage.command = json.loads(rest)
        case "HEALTHCHECK":
            stage.health = json.loads(rest.partition(" CMD ")[2])
        case "LABEL" | "EXPOSE" | "STOPSIGNAL":
            pass
        case _:
            raise ValueError(f"no rule for the instruction {name}")


def _copy(stage: Stage, rest: str, stages: dict[str, Stage]) -> None:
    """Copy from the project, without what the builder is not sent, or from another stage."""
    words = rest.split()
    sent = PROJECT
    if words[0].startswith("--from="):
        sent = stages[words.pop(0).removeprefix("--from=")].root
    *sources, target = words
    there = stage.root / Path(stage.workdir, target).as_posix().lstrip("/")
    for source in sources:
        found = sent / source.lstrip("/")
        to = there if found.is_dir() else there / found.name
        to.parent.mkdir(parents=True, exist_ok=True)
        if found.is_dir():
            leaves = shutil.ignore_patterns("__pycache__", "*.pyc")
            shutil.copytree(found, to, symlinks=True, ignore=leaves, dirs_exist_ok=True)
        else:
            shutil.copy2(found, to)


@contextmanager
def _pip_of_this_machine(root: Path, mounts: Sequence[Path]) -> Iterator[dict[str, str]]:
    """Show a build the resolver and pip's settings of this machine, and the folders it may read."""
    with ExitStack() as ending:
        for file in (Path("/etc/resolv.conf"), Path("/etc/ssl/certs/ca-certificates.crt")):
            if file.is_file():
                shutil.copy2(file, root / str(file)[1:])
        settings = root / "etc/pip.conf"
        texts = [file.read_text() for file in PIP_FILES if file.is_file()]
        settings.write_text("\n".join(dict.fromkeys("\n".join(texts).splitlines())))
        ending.callback(settings.unlink)
        for place in (Path("/dev"), *mounts):
            inside = root / str(place.resolve())[1:]
            inside.mkdir(parents=True, exist_ok=True)
            _do(["mount", "--bind", str(place), str(inside)])
            ending.callback(_do, ["umount", str(inside)])
            if place in mounts:
                _do(["mount", "-o", "remount,bind,ro", str(inside)])
        yield {name: value for name, value in os.environ.items() if name.startswith("PIP_")}


def _remove(root: Path) -> None:
    """Remove a root, and nothing of another file system that is still mounted there."""
    _do(["rm", "-rf", "--one-file-system", str(root)])


def _do(words: Sequence[str]) -> None:
    sys.stderr.write(f"+ {shlex.join(words)[:160]}\n")
    sys.stderr.flush()
    subprocess.run(words, check=True, stdout=sys.stderr)


def main() -> None:
    """Build a target, print its size, and run a command in it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--target", default="service")
    parser.add_argument("--arg", action="append", default=[], help="NAME=VALUE of an ARG")
    parser.add_argument("--mount", action="append", default=[], type=Path)
    parser.add_argument("--run", default="", help="arguments of the entry point to run at the end")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    args = dict(each.split("=", 1) for each in given.arg)
    stage = build(given.target, given.folder.resolve(), args=args, mounts=given.mount)
    _do(["du", "-sh", str(stage.root)])
    _do(stage.run([*stage.entry, *(shlex.split(given.run) or ["--version"])]))


if __name__ == "__main__":
    main()
