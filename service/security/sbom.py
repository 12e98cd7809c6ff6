"""Bill of materials of an installation: CycloneDX 1.5, from the metadata of what is installed."""

import re
import uuid
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from typing import Any, Final

from packaging.markers import default_environment
from packaging.requirements import InvalidRequirement, Requirement

OURS: Final = "counterpoint"

FORMAT: Final = {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1}


def bill_of_materials() -> dict[str, Any]:
    """Return every installed package that Counterpoint needs, with version, licence and hashes.

    A package of an extra that is not installed is left out. Equal installations give equal bills.
    """
    found = dict(sorted(_needed(), key=lambda each: each[0]))
    components = [_component(name, each) for name, each in found.items() if name != OURS]
    ours = found[OURS]
    content = "\n".join(f"{each['name']}=={each['version']}" for each in components)
    serial = uuid.uuid5(uuid.NAMESPACE_URL, f"{ours.version}\n{content}")
    return {
        **FORMAT,
        "serialNumber": f"urn:uuid:{serial}",
        "metadata": {"component": {**_component(OURS, ours), "type": "application"}},
        "components": components,
        "dependencies": [
            {
                "ref": _url(name, each.version),
                "dependsOn": sorted(
                    _url(needed, found[needed].version)
                    for needed in {needed for needed, _ in _requirements(each, frozenset())}
                    if needed in found
                ),
            }
            for name, each in found.items()
        ],
    }


def _needed() -> Iterator[tuple[str, Distribution]]:
    """Yield each installed package by its normalised name, from ours to what it needs."""
    extras = frozenset(distribution(OURS).metadata.get_all("Provides-Extra") or ()) - {"dev"}
    waiting: list[tuple[str, frozenset[str]]] = [(OURS, extras)]
    seen: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        name, wanted = waiting.pop()
        if (name, wanted) in seen:
            continue
        seen.add((name, wanted))
        try:
            found = distribution(name)
        except PackageNotFoundError:
            continue
        yield name, found
        waiting += _requirements(found, wanted)


def _requirements(
    package: Distribution, extras: frozenset[str]
) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield name and extras of what a package needs here."""
    environment = {key: str(value) for key, value in default_environment().items()}
    for line in package.requires or ():
        try:
            needed = Requirement(line)
        except InvalidRequirement:
            continue
        marker = needed.marker
        if marker is None or any(
            marker.evaluate({**environment, "extra": extra}) for extra in ("", *extras)
        ):
            yield _normal(needed.name), frozenset(needed.extras)


def _component(name: str, package: Distribution) -> dict[str, Any]:
    meta = package.metadata
    licence = _said(package, "License-Expression")
    licence = licence or _classified(meta.get_all("Classifier") or [])
    licence = licence or _said(package, "License").partition("\n")[0][:100]
    component: dict[str, Any] = {
        "type": "library",
        "bom-ref": _url(name, package.version),
        "name": name,
        "version": package.version,
        "purl": _url(name, package.version),
    }
    if summary := _said(package, "Summary"):
        component["description"] = summary
    if licence:
        component["licenses"] = [{"license": {"name": licence}}]
    return component


def _said(package: Distribution, field: str) -> str:
    return str(package.metadata[field]) if field in package.metadata else ""


def _classified(classifiers: list[str]) -> str:
    found = [each.rpartition(" :: ")[2] for each in classifiers if each.startswith("License ::")]
    return ", ".join(found)


def _url(name: str, version: str) -> str:
    return f"pkg:pypi/{name}@{version}"


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
