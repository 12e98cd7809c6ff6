"""Rules of access control for Zenoh, by role: a file that `zenoh_config` lays over ours.

What no rule allows is denied, for certificates of our authority too. A worker may put records, ask
and be alive only under its own name, so it cannot act for another one.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from schemas.bounds import MAX_COMMIT_BYTES
from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys
from service.api.verbs import OF_PEOPLE, OF_WORKERS, VERBS
from service.output_files import MARK
from service.security.names import BUS_ROLES

MAX_SESSIONS: Final = 1000
"""Sessions of one router at a time; one more is refused."""

RECORD_ROOM_BYTES: Final = 2 * MAX_RECORD_BYTES
"""Limit of a message with a record, bytes: the record and what Zenoh adds to it."""

OF_OPERATORS: Final = ("audit",)
"""Verbs that only operators may ask, without a name."""

OF_READERS: Final = ("exported",)
"""Verbs of the audit log that readers may ask, under their own name."""

_ASK: Final = ("query",)
_ANSWER: Final = ("reply", "declare_queryable")
_SUBSCRIBE: Final = ("declare_subscriber",)
_SEE_LIVE: Final = ("liveliness_query", "declare_liveliness_subscriber")

_EVERY_MESSAGE: Final = (
    *("put", "delete", "query", "reply", "declare_subscriber", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


def reading_verbs() -> tuple[str, ...]:
    """Return the verbs that readers may ask without a name."""
    kept = {"hello", *OF_WORKERS, *OF_PEOPLE, *OF_OPERATORS}
    return tuple(verb for verb in VERBS if verb not in kept)


def access_rules(names: Mapping[str, Iterable[str]], *, root: str) -> dict[str, Any]:
    """Make Zenoh's settings for a router of the system.

    Args:
        names: Names of the certificates, by role.
        root: First part of every key.
    """
    rules: list[dict[str, Any]] = []
    listed: dict[str, list[str]] = {role: sorted(set(names.get(role, ()))) for role in BUS_ROLES}
    subjects: list[dict[str, Any]] = [
        {"id": role, "cert_common_names": listed[role]}
        for role in ("router", "service", "reader", "operator")
        if listed[role]
    ]
    policies: list[dict[str, Any]] = []

    def allow(
        who: str, flow: str, messages: Iterable[str], key_exprs: Iterable[str], *, what: str
    ) -> None:
        rule = f"{who} {flow}: {what}"
        rules.append(
            {
                "id": rule,
                "permission": "allow",
                "flows": [flow],
                "messages": list(messages),
                "key_exprs": list(key_exprs),
            }
        )
        policies.append({"rules": [rule], "subjects": [who]})

    everything = [f"{root}/**", f"{root}/**/@adv/**", f"{root}/v1/scene/**/@adv/**"]
    for role in ("router", "service"):
        if listed[role]:
            for flow in ("ingress", "egress"):
                allow(role, flow, _EVERY_MESSAGE, everything, what="everything")
    for name in listed["worker"]:
        subjects.append({"id": f"worker {name}", "cert_common_names": [name]})
        _worker(allow, f"worker {name}", keys.owned_by(name), root=root)
    for role in ("reader", "operator"):
        if listed[role]:
            _reader(allow, role, root=root)
        for name in listed[role]:
            who = f"{role} {name}"
            subjects.append({"id": who, "cert_common_names": [name]})
            verbs = OF_PEOPLE if role == "operator" else OF_READERS
            own = [keys.named_control(root=root, verb=verb, name=name) for verb in verbs]
            allow(who, "ingress", _ASK, own, what="ask in its own name")
            allow(who, "egress", ("reply",), own, what="be answered")
    if listed["operator"]:
        audit = [keys.control(root=root, verb="audit")]
        allow("operator", "ingress", _ASK, audit, what="read the audit log")
        allow("operator", "egress", ("reply",), audit, what="get the audit log")
    return {
        "metadata": {"generator": MARK},
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        },
        "low_pass_filter": _size_limits(root),
        "transport": {"unicast": {"max_sessions": MAX_SESSIONS}},
    }


def _worker(allow: Any, who: str, own: str, *, root: str) -> None:
    """Let a worker put its records, ask for its leases, and be alive, under its own name only."""
    score = f"{root}/v1/score/{own}"
    own_scores = [score, f"{score}/**", f"{score}/@adv/**"]
    asks = [f"{root}/v1/ctl/{verb}/{own}" for verb in OF_WORKERS]
    asks += [keys.control(root=root, verb=verb) for verb in ("hello", "about")]
    alive = [f"{root}/v1/live/worker/{own}"]
    allow(who, "ingress", ("put",), own_scores, what="put its records")
    allow(who, "ingress", _ANSWER, own_scores, what="give its records again")
    allow(
        who,
        "egress",
        ("query", *_SUBSCRIBE),
        [*own_scores, f"{root}/v1/score/**"],
        what="know who wants them",
    )
    allow(who, "ingress", _ASK, asks, what="ask for its leases")
    allow(
        who,
        "egress",
        ("reply", "declare_queryable"),
        [*asks, *(f"{root}/v1/ctl/{verb}/*" for verb in OF_WORKERS)],
        what="be answered",
    )
    allow(who, "ingress", ("liveliness_token",), [*alive, *own_scores], what="be alive")


def _reader(allow: Any, role: str, *, root: str) -> None:
    """Let readers follow scenes, selections and verdicts, and ask what changes nothing."""
    published = [
        keys.all_scenes(root=root),
        keys.scene_cache(root=root),
        keys.all_selected(root=root),
        keys.all_verdicts(root=root),
    ]
    asks = [keys.control(root=root, verb=verb) for verb in reading_verbs()]
    live = [keys.all_live(root=root, role=each) for each in ("service", "worker")]
    allow(role, "ingress", (*_SUBSCRIBE, *_ASK), published, what="follow scenes")
    allow(role, "egress", ("put", "delete", "reply"), published, what="get scenes")
    allow(
        role,
        "egress",
        ("declare_queryable",),
        [*published, *asks, f"{root}/v1/ctl/**"],
        what="know who answers",
    )
    allow(role, "ingress", _ASK, asks, what="ask what changes nothing")
    allow(role, "egress", ("reply",), asks, what="be answered")
    allow(role, "ingress", _SEE_LIVE, live, what="ask who is alive")
    allow(role, "egress", ("liveliness_token",), live, what="learn who is alive")


def _size_limits(root: str) -> list[dict[str, Any]]:
    return [
        {
            "id": "records",
            "flows": ["ingress"],
            "messages": ["put"],
            "key_exprs": [f"{root}/v1/score/**"],
            "size_limit": RECORD_ROOM_BYTES,
        },
        {
            "id": "questions",
            "flows": ["ingress"],
            "messages": ["query"],
            "key_exprs": [f"{root}/v1/ctl/**"],
            "size_limit": MAX_COMMIT_BYTES + 4096,
        },
    ]
