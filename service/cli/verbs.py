"""Verbs of the command: the file of each, of which only that of the verb that runs is loaded."""

from importlib import import_module
from types import ModuleType
from typing import Final

FILES: Final = {
    "daemons": ("run", "service", "worker", "router"),
    "logs": ("inspect", "score"),
    "scenes": ("watch", "top", "show", "status"),
    "selections": ("select", "selection"),
    "verdicts": ("agreement", "verdict"),
    "exports": ("export",),
    "label_imports": ("import-labels",),
    "compare": ("compare",),
    "modes": ("modes",),
    "plan": ("plan",),
    "rates": ("rates",),
    "retry": ("retry",),
    "review": ("review",),
    "security": ("certs", "acl", "token", "audit", "sbom"),
    "demo": ("demo",),
    "simulate": ("simulate",),
    "convert": ("convert",),
    "evaluate": ("eval",),
    "measure": ("bench",),
    "calibrate": ("calibrate",),
    "lidarcoda": ("lidarcoda",),
    "parts": ("parts",),
    "settings": ("config", "doctor"),
    "weights": ("weights",),
    "teach": ("adapt", "train"),
}
"""Verbs of each file of this package, in the order of the help."""


def files_of(verb: str | None) -> list[ModuleType]:
    """Load the file of a verb; without a verb, or for an unknown one, load all of them in order."""
    for file, verbs in FILES.items():
        if verb in verbs:
            return [import_module(f"service.cli.{file}")]
    return _all_files()


def _all_files() -> list[ModuleType]:
    from service.cli import (
        calibrate,
        compare,
        convert,
        daemons,
        demo,
        evaluate,
        exports,
        label_imports,
        lidarcoda,
        logs,
        measure,
        modes,
        parts,
        plan,
        rates,
        retry,
        review,
        scenes,
        security,
        selections,
        settings,
        simulate,
        teach,
        verdicts,
        weights,
    )

    mining = [daemons, logs, scenes, selections, verdicts, exports, label_imports]
    looking = [compare, modes, plan, rates, retry, review, security]
    judges = [evaluate, measure, calibrate, lidarcoda]
    return [*mining, *looking, demo, simulate, convert, *judges, parts, settings, weights, teach]
