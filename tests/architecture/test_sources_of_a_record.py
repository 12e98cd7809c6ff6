"""The pipeline version covers everything that mining imports, ours and others'."""

import sys
from importlib import metadata
from typing import Final

import grimp
import pytest

from workers import sources
from workers.layers import ROOTS
from workers.version import LIBRARIES

NO_NUMBERS: Final = {
    "google": "generated classes of protobuf messages, read by mcap-protobuf-support",
    "lz4": "unpacks bytes, or fails",
    "obstore": "fetches bytes, or fails",
    "onnxruntime": "runs own models only, and is not there without them",
    "pyarrow": "reads rows of boxes as written, or fails",
    "pydantic": "checks settings and records",
    "pydantic_core": "checks settings and records",
    "safetensors": "reads weights, whose bytes are digested",
    "structlog": "logs",
    "zstandard": "unpacks bytes, or fails",
}
"""Libraries that no value of a record depends on, and why."""


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    # Without its cache, which does not notice every new import of a file that changed.
    return grimp.build_graph("schemas", "workers", include_external_packages=True, cache_dir=None)


def within(module: str, names: frozenset[str]) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in names)


def test_every_module_that_mining_imports_is_in_the_pipeline_version(
    graph: grimp.ImportGraph,
) -> None:
    imported, waiting = set[str](), set(ROOTS)
    while waiting:
        module = waiting.pop()
        if module.split(".")[0] not in sources.OURS or within(module, sources.NO_EFFECT_ON_RECORDS):
            continue
        imported.add(module)
        waiting |= graph.find_modules_directly_imported_by(module) - imported
    assert len(imported) > 100
    assert imported - sources.sources(*ROOTS) == set()


@pytest.mark.parametrize(
    "package",
    ["ingest", "odometry", "supervised", "selfsupervised", "witness", "contradiction", "lidar"],
)
def test_every_stage_is_in_the_pipeline_version(package: str) -> None:
    found = sources.sources(*ROOTS)
    assert any(module.startswith(f"workers.{package}.") for module in found)


def test_what_mining_never_enters_is_not_in_the_pipeline_version() -> None:
    assert [module for module in sources.sources(*ROOTS) if "lab" in module.split(".")] == []


@pytest.mark.parametrize("module", sorted(sources.NO_EFFECT_ON_RECORDS))
def test_what_is_left_out_of_the_version_exists(module: str, graph: grimp.ImportGraph) -> None:
    assert module in graph.modules


def test_every_library_that_mining_imports_is_in_the_version_or_shapes_no_number(
    graph: grimp.ImportGraph,
) -> None:
    distributions = metadata.packages_distributions()
    unknown = set()
    for module in sources.sources(*ROOTS):
        for imported in graph.find_modules_directly_imported_by(module):
            top = imported.split(".")[0]
            if top in sources.OURS or top in sys.stdlib_module_names or top in NO_NUMBERS:
                continue
            if not {top, *distributions.get(top, ())} & set(LIBRARIES):
                unknown.add(top)
    assert unknown == set()
