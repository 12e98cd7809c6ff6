"""Checks of `doctor` on the network: the router, the service behind it, ports to listen on."""

import errno
import socket
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Final

import zenoh

from schemas.errors import PermanentError
from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask
from schemas.transport.bus import client_session
from schemas.transport.locks import days_left, name_in
from schemas.transport.wire import decode_reply
from service.api.messages import AboutReply
from service.background.heartbeat import workers_alive
from service.doctor.finding import Finding, ok, problem, warning
from service.security.authority import is_signed_by, role_in
from service.security.listening import has_rules, open_bus, open_pages
from service.settings.config import Settings
from service.store.state import endpoint_of_running

PATIENCE_S = 3.0

SOON_DAYS: Final = 30
"""Rest of a certificate's validity from which it should be renewed, days."""

PAGES_OF: Final = {
    "router": (),
    "service": ("http_listen", "worker_http_listen"),
    "worker": ("worker_http_listen",),
    "reader": ("review_listen",),
    "operator": ("review_listen",),
}
"""Settings of the pages that a process serves, by the role of its certificate. Without one it may
be a service, or workers.
"""


def router(settings: Settings) -> Iterator[Finding]:
    """Connect to the router, ask for a service, and count the workers."""
    endpoint = settings.connect or endpoint_of_running(settings.state)
    if not endpoint:
        yield ok("router", "none is named: `run` brings its own; else give --connect tcp/HOST:PORT")
        return
    with client_session(endpoint.split(","), locks=settings.client_locks) as session:
        yield ok("router", f"answers at {endpoint}")
        yield from _service(session, settings)


def _service(session: zenoh.Session, settings: Settings) -> Iterator[Finding]:
    """Ask a service for its version, and count the workers that this certificate may see."""
    root = settings.root
    version_found = _of_which_version(session, root=root)
    if version_found is None:
        yield warning("service", _no_answer(settings))
        return
    yield version_found
    workers = workers_alive(session, root=root)
    if not workers and settings.locks.is_set and not _sees_the_service(session, root=root):
        yield ok(
            "service",
            f"the certificate of {settings.locks.name} may not see its workers: `counterpoint "
            "status` of an operator counts them",
        )
        return
    say = ok if workers else warning
    yield say("service", f"has {workers} workers" + ("" if workers else ", so nothing is mined"))


def _no_answer(settings: Settings) -> str:
    says = f"none answers under {settings.root!r}: start `counterpoint service`, or check the "
    if not settings.locks.is_set:
        return f"{says}setting root"
    return (
        f"{says}setting root; else no rule of the router names this certificate, "
        f"{settings.locks.name}, as after its revocation: write the rules again by `counterpoint "
        "acl`, and restart the routers"
    )


def _sees_the_service(session: zenoh.Session, *, root: str) -> bool:
    """Return true if this session sees who is alive: the service that just answered is."""
    alive = keys.all_live(root=root, role="service")
    return any(reply.ok is not None for reply in session.liveliness().get(alive, timeout=5))


def _of_which_version(session: zenoh.Session, *, root: str) -> Finding | None:
    """Compare the version of a service with ours; None: none answers.

    Every role may ask `about`, and only workers and services `hello`, which older ones know too.
    """
    answers, ours = f"answers under {root!r}", version("counterpoint")
    try:
        about = ask(session, keys.control(root=root, verb="about"), timeout_s=PATIENCE_S)
    except UnansweredError:
        try:
            ask(session, keys.control(root=root, verb="hello"), timeout_s=PATIENCE_S)
        except UnansweredError:
            return None
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
    """Check that the addresses of pages that a process of these settings serves can be used.

    One that is taken is no problem: the process that these settings are for may be running.
    """
    held = endpoint_of_running(settings.state) is not None
    for name in _served_by(settings):
        listen = getattr(settings, name)
        if not listen:
            yield ok("http", f"{name} is empty: nothing is served")
            continue
        why = _why_not(listen)
        if why is None:
            yield ok("http", f"{listen} is free ({name})")
        elif why.errno != errno.EADDRINUSE:
            say = problem if name == "http_listen" else warning
            reason = why.strerror or str(why)
            yield say("http", f"cannot listen on {listen}: {reason}; choose another {name}")
        elif held and name == "http_listen":
            yield ok("http", f"{listen} is taken, by the service on this state it seems ({name})")
        else:
            yield warning(
                "http",
                f"{listen} is taken, by a process that runs already it seems; where it is none of "
                f"these settings, choose another {name}",
            )


def _served_by(settings: Settings) -> tuple[str, ...]:
    """Return the settings of the pages that a process with this certificate serves."""
    role = ""
    if settings.locks.is_set:
        with suppress(PermanentError):  # said under `locks`
            role = role_in(Path(settings.tls_certificate))
    return PAGES_OF.get(role, PAGES_OF["service"])


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
    if not is_signed_by(Path(settings.tls_certificate), Path(settings.tls_ca)):
        yield problem(
            "locks",
            f"another authority than that of tls_ca has signed the certificate of "
            f"{settings.locks.name}: copy both from the same authority ({settings.tls_ca})",
        )


def _validity(path: Path) -> Finding:
    name, days = name_in(path), days_left(path)
    if days < 0:
        return problem("locks", f"the certificate of {name} has expired: renew it ({path})")
    say = warning if days < SOON_DAYS else ok
    return say("locks", f"the certificate of {name} is valid for {days} days ({path})")


def _why_not(listen: str) -> OSError | None:
    host, colon, port = listen.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65_535:
        return OSError("it is not HOST:PORT")
    try:
        found = socket.getaddrinfo(host.strip("[]") or None, int(port), type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        return error
    return None
