"""Verb `review`: the page on which scenes are looked at and judged."""

import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from schemas.errors import TransientError
from schemas.runtime.http_address import is_loopback_host
from service.cli.options import (
    Artifacts,
    Config,
    Connect,
    Database,
    LogFormat,
    LogLevel,
    StateToRead,
    settings_for,
)
from service.cli.output import remark
from service.cli.scenes import reader
from service.errors import StateOutdatedError, UsageError
from service.settings.config import Settings

if TYPE_CHECKING:
    from fastapi import FastAPI

    from service.export.jobs import ExportJobs

OPEN: Final = "look at the scenes and judge them"

STOPPING: Final = "stopping: the page is closed; every verdict that was answered is stored"

NEEDS_EXTRA: Final = (
    "the review page needs the extra `review`: pip install 'counterpoint[review]' (missing: {})"
)

_LIBRARIES: Final = ("fastapi", "jinja2", "python_multipart", "uvicorn")

_LOOK_S: Final = 0.5
_END_S: Final = 8.0
"""Time for the process of the page to end, seconds."""

_EVERYWHERE: Final = frozenset({"0.0.0.0", "::"})  # noqa: S104
"""Addresses that mean every address of a machine, and name none."""

ReviewListen = Annotated[
    str | None,
    typer.Option(
        "--listen", help="HOST:PORT of the page; port 0 takes a free one. 127.0.0.1:8087."
    ),
]
Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", help="Further name under which browsers ask for the page. Repeatable."),
]
Exports = Annotated[
    str | None,
    typer.Option(
        "--exports",
        help="Folder or bucket URL of the exports started on the page; default: exports in the "
        "state folder.",
    ),
]


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint review --state counterpoint-state")(review)


def review(
    state: StateToRead = None,
    connect: Connect = None,
    database: Database = None,
    artifacts: Artifacts = None,
    listen: ReviewListen = None,
    host: Hosts = None,
    exports: Exports = None,
    config: Config = None,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
    end_with_stdin: Annotated[
        bool, typer.Option(hidden=True, help="Stop when stdin ends.")
    ] = False,
) -> None:
    """Serve the review page: look at the ranked scenes, judge them, make selections.

    A service that runs on the state stores the verdicts; without one, this command does. On any
    other address than the loopback the page needs TLS, and tokens or a proxy that signs people in.
    """
    from service.client import ControlClient

    need_extra()
    is_state = not isinstance(
        reader(config, connect=connect, state=state, database=database), ControlClient
    )
    settings = settings_for(
        config,
        connect=connect,
        state=state,
        database=database,
        artifacts=artifacts,
        review_listen=listen,
        review_hosts=host,
        review_exports=exports,
        log_format=log_format,
        log_level=log_level,
    )
    from schemas.runtime.process import stop_on_signals

    if is_state:
        bring_up_to_date(settings)
    with stop_on_signals(partial(remark, STOPPING)) as stop:
        if end_with_stdin:
            threading.Thread(target=_wait_for_end, args=(stop,), daemon=True).start()
        with page_of(settings, is_state=is_state, config=config) as thread:
            while thread.is_alive() and not stop.wait(_LOOK_S):
                pass


def serve_until_stopped(settings: Settings) -> None:
    """Serve the page of a state until Ctrl-C, on a free port if its own is taken."""
    from schemas.runtime.process import stop_on_signals

    with stop_on_signals(partial(remark, STOPPING)) as stop, ExitStack() as opened:
        try:
            thread = opened.enter_context(page_of(settings, is_state=True))
        except TransientError:
            free = settings.model_copy(update={"review_listen": "127.0.0.1:0"})
            thread = opened.enter_context(page_of(free, is_state=True))
        remark(f"{OPEN}: open the address in a browser; end with Ctrl-C")
        while thread.is_alive() and not stop.wait(_LOOK_S):
            pass


@contextmanager
def review_process(flags: Mapping[str, object]) -> Iterator[None]:
    """Run `counterpoint review` as a process of its own within a `with` block.

    It prints its address itself. It ends with this process, however that ends.

    Args:
        flags: Values of its options by name; None: it is not given.
    """
    arguments = [
        part
        for name, value in flags.items()
        if value is not None
        for part in (f"--{name.replace('_', '-')}", str(value))
    ]
    command = [sys.executable, "-P", "-m", "service.cli", "review", "--end-with-stdin", *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:  # noqa: S603
        try:
            yield
        finally:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def page_of(
    settings: Settings, *, is_state: bool, config: Path | None = None
) -> Iterator[threading.Thread]:
    """Serve the page of a state or a service within a `with` block, and print its address.

    Args:
        settings: Settings of the page.
        is_state: True for a state folder, with or without a service.
        config: File of the settings, which exports read too.
    """
    from service.security.listening import need_locked_pages, page_guard
    from service.web.server import address_in, address_of, listening, serving, url_of

    own, _ = address_of(settings.review_listen)
    need_locked_pages(settings, settings.review_listen, setting="review_listen")
    is_tls = page_guard(settings).tls is not None  # which checks the files
    hosts = frozenset(settings.review_hosts) | ({own} - _EVERYWHERE)
    if not hosts:
        raise UsageError(
            f"{settings.review_listen} is every address of this machine: set review_hosts, or give "
            "--host, for each name under which browsers may ask for the page"
        )
    jobs = exports_of(settings, is_state=is_state, config=config)
    app = _app_of(settings, hosts, jobs, is_state=is_state)
    with (
        nullcontext() if jobs is None else closing(jobs),
        listening(settings.review_listen) as opened,
        serving(
            app,
            opened,
            on_stop=app.state.closing.set,
            certificate=settings.http_certificate,
            key=settings.http_key,
        ) as thread,
    ):
        where = f" (listens on every address, {address_in(opened)})" if own in _EVERYWHERE else ""
        remark(f"review page: {url_of(opened, scheme='https' if is_tls else 'http')}{where}")
        if not is_loopback_host(own) and not app.state.settings.doors.are_locked:
            remark(
                f"other machines reach the page as {', '.join(sorted(hosts))}: it has no password, "
                "and all who reach it can judge",
                level="warning",
            )
        yield thread


def exports_of(
    settings: Settings, *, is_state: bool, config: Path | None = None
) -> "ExportJobs | None":
    """Return the exports that a page may start; None where it has no folder for them."""
    from service.export.jobs import ExportJobs

    if not (settings.review_exports or is_state):
        return None
    options = {"config": str(config)} if config is not None else {}
    if is_state:
        options["state"] = str(settings.state)
    else:
        options["connect"] = settings.connect
    if settings.artifacts:
        options["artifacts"] = settings.artifacts
    return ExportJobs(
        settings.review_exports or str(settings.state / "exports"),
        program=(sys.executable, "-P", "-m", "service.cli"),
        options=options,
        hidden={"database": settings.database} if settings.database else {},
    )


def _app_of(
    settings: Settings, hosts: frozenset[str], jobs: "ExportJobs | None", *, is_state: bool
) -> "FastAPI":
    from service.client import ControlClient
    from service.web.app import make_app
    from service.web.roles import doors_of
    from service.web.settings import WebSettings, key_of_state
    from service.web.source import source_of_state

    web_settings = partial(
        WebSettings,
        hosts=hosts,
        doors=doors_of(settings),
        rate=settings.http_rate,
        is_secure=bool(settings.http_certificate),
    )
    if is_state:
        folder = settings.state if settings.state.is_dir() else None
        place = str(settings.state)
        key = key_of_state(folder, place=settings.database or place)
        return make_app(source_of_state(settings), web_settings(place, key), jobs)
    place = settings.connect
    key = key_of_state(None, place=f"{settings.root} {place}")
    client = ControlClient(settings.connect.split(","), root=settings.root, locks=settings.locks)
    return make_app(client, web_settings(place, key), jobs)


def bring_up_to_date(settings: Settings) -> None:
    """Migrate the state of an earlier version, as a service does at its start.

    Raises:
        StateInUseError: If a service of that version runs on it.
    """
    from service.store.opening import open_ledger_store, open_ledger_store_to_read, sole_service
    from service.store.state import StateLock

    try:
        open_ledger_store_to_read(settings).close()
    except StateOutdatedError:
        with StateLock(settings.state), sole_service(settings):
            open_ledger_store(settings).close()
        remark(f"the state was brought up to date: {settings.state}")


def has_extra() -> bool:
    """Return true if the libraries of the page are installed."""
    return not _missing()


def need_extra() -> None:
    """Refuse to start without the libraries of the page.

    Raises:
        UsageError: If one is missing; the message names the extra.
    """
    if missing := _missing():
        raise UsageError(NEEDS_EXTRA.format(", ".join(missing)))


def _missing() -> list[str]:
    return [name for name in _LIBRARIES if find_spec(name) is None]


def _wait_for_end(stop: threading.Event) -> None:
    """Stop when stdin ends, since the process that started this one has ended."""
    while sys.stdin.buffer.read(1):
        pass
    stop.set()
