"""Checks of `doctor` on the network: the router, the service behind it, ports to listen on."""

import socket
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Final

import zenoh

from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask
from schemas.transport.bus import client_session
from schemas.transport.locks import days_left, name_in
from schemas.transport.wire import decode_reply
from service.api.messages import AboutReply
from service.background.heartbeat import workers_alive
from service.doctor.finding import Finding, ok, problem, warning
from service.security.listening import has_rules, open_bus, open_pages
from service.settings.config import Settings
from service.store.state import endpoint_of_running

PATIENCE_S = 3.0

SOON_DAYS: Final = 30
"""Rest of a certificate's validity from which it should be renewed, days."""


def router(settings: Settings) -> Iterator[Finding]:
    """Connect to the router, ask for a service, and count the workers."""
    endpoint = settings.connect or endpoint_of_running(settings.state)
    if not endpoint:
        yield ok("router", "none is named: `run` brings its own; else give --connect tcp/HOST:PORT")
        return
    with client_session(endpoint.split(","), locks=settings.client_locks) as session:
        yield ok("router", f"answers at {endpoint}")
        hello = keys.control(root=settings.root, verb="hello")
        try:
            ask(session, hello, timeout_s=PATIENCE_S)
        except UnansweredError:
            yield warning(
                "service",
                f"none answers under {settings.root!r}: start `counterpoint service`, or check the "
                "setting root",
            )
            return
        yield _of_which_version(session, root=settings.root)
        workers = workers_alive(session, root=settings.root)
        say = ok if workers else warning
        yield say(
            "service", f"has {workers} workers" + ("" if workers else ", so nothing is mined")
        )


def _of_which_version(session: zenoh.Session, *, root: str) -> Finding:
    answers, ours = f"answers under {root!r}", version("counterpoint")
    try:
        about = ask(session, keys.control(root=root, verb="about"), timeout_s=PATIENCE_S)
    except UnansweredError:
        theirs = "an older version that does not report its own number,"
    else:
        theirs = f"version {decode_reply(AboutReply, about, to='about').package}"
    if theirs == f"version {ours}":
        return ok("service", f"{answers}, of {theirs}")
    return warning(
        "service",
        f"{answers}, but is of {theirs} and this command of version {ours}: their "
        "messages may differ; use the command of its version, or upgrade and restart it",
    )


def http(settings: Settings) -> Iterator[Finding]:
    """Check that the ports for metrics can be listened on."""
    held = endpoint_of_running(settings.state) is not None
    for name, listen in (
        ("http_listen", settings.http_listen),
        ("worker_http_listen", settings.worker_http_listen),
    ):
        if not listen:
            yield ok("http", f"{name} is empty: nothing is served")
            continue
        why = _why_not(listen)
        if not why:
            yield ok("http", f"{listen} is free ({name})")
        elif held and name == "http_listen":
            yield ok("http", f"{listen} is taken, by the service on this state it seems ({name})")
        else:
            say = problem if name == "http_listen" else warning
            yield say("http", f"cannot listen on {listen}: {why}; choose another {name}")


def locks(settings: Settings) -> Iterator[Finding]:
    """Report what other machines reach without a lock, and certificates that end soon."""
    connects = settings.connect.split(",") if settings.connect else []
    listens = settings.listen.split(",") if settings.listen else []
    found = [open_bus(settings, listens=listens, connects=connects)]
    found += [
        open_pages(settings, getattr(settings, name), setting=name)
        for name in ("http_listen", "worker_http_listen", "review_listen")
    ]
    say = warning if settings.insecure else problem
    for each in filter(None, found):
        yield say("locks", f"insecure: {each}" if settings.insecure else each)
    if settings.insecure and not any(found):
        yield warning("locks", "insecure = true is written, and nothing needs it: take it out")
    if not settings.locks.is_set:
        if not any(found):
            yield ok("locks", "none, and none are needed: the loopback alone is listened on")
        return
    if listens and not has_rules(settings):
        yield warning(
            "locks",
            "no rules: every certificate of the authority may do everything; write rules by "
            "`counterpoint acl` and name them as zenoh_config",
        )
    yield _validity(Path(settings.tls_certificate))


def _validity(path: Path) -> Finding:
    name, days = name_in(path), days_left(path)
    if days < 0:
        return problem("locks", f"the certificate of {name} has expired: renew it ({path})")
    say = warning if days < SOON_DAYS else ok
    return say("locks", f"the certificate of {name} is valid for {days} days ({path})")


def _why_not(listen: str) -> str:
    host, colon, port = listen.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65_535:
        return "it is not HOST:PORT"
    try:
        found = socket.getaddrinfo(host.strip("[]") or None, int(port), type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        return error.strerror or str(error)
    return ""
