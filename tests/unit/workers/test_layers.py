"""Layers of the pipeline version: each module in one, each change in its own."""

from collections.abc import Mapping

import pytest

from tests.unit.workers.test_version import PARTS, SETTINGS
from workers import layers, version
from workers.layers import ROOTS, Layer, LayerDigests, modules_of_layers
from workers.sources import sources
from workers.version import layers_of, pipeline_version


def test_each_module_of_mining_is_in_exactly_one_layer() -> None:
    found = modules_of_layers()
    together = [module for modules in found.values() for module in modules]
    assert len(together) == len(set(together))
    assert set(together) == sources(*ROOTS)


@pytest.mark.parametrize(
    ("module", "layer"),
    [
        ("workers.contradiction.attribution", Layer.SCORE),
        ("workers.contradiction.score", Layer.SCORE),
        ("workers.contradiction.score_settings", Layer.SCORE),
        ("workers.contradiction.track_score", Layer.SCORE),
        ("workers.contradiction.feature_extraction", Layer.CONTRADICTIONS),
        ("workers.contradiction.instances", Layer.CONTRADICTIONS),
        ("workers.contradiction.overlay", Layer.CONTRADICTIONS),
        ("workers.contradiction.scoring_inputs", Layer.CONTRADICTIONS),
        ("workers.ingest.plan", Layer.LABELS),
        ("workers.mine", Layer.LABELS),
        ("workers.odometry.odometry", Layer.LABELS),
        ("workers.pipeline", Layer.LABELS),
        ("workers.selfsupervised.stream", Layer.LABELS),
        ("workers.supervised.stream", Layer.LABELS),
        ("workers.witness.free_space", Layer.LABELS),
    ],
)
def test_a_module_is_in_the_first_layer_that_needs_it(module: str, layer: Layer) -> None:
    assert module in modules_of_layers()[layer]


def test_no_layer_imports_a_later_one_but_for_the_overlay_and_the_pipeline() -> None:
    """What a layer keeps must not depend on what is computed from it."""
    found = modules_of_layers()
    for module in found[Layer.CONTRADICTIONS] - {"workers.contradiction.overlay"}:
        assert not sources(module) & found[Layer.SCORE], module
    tops = {"workers.mine", "workers.pipeline"}
    later = found[Layer.CONTRADICTIONS] | found[Layer.SCORE]
    for module in found[Layer.LABELS] - tops - {"schemas", "workers"}:
        if module.count(".") > 1:  # a package digests all in it
            assert not sources(module) & later or module.endswith("pictures"), module


@pytest.mark.parametrize("layer", list(Layer))
def test_a_changed_source_changes_its_layer_and_the_version(
    layer: Layer, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = layers_of(SETTINGS, PARTS)
    found: Mapping[Layer, str] = dict(layers.source_digests()) | {layer: "another"}
    monkeypatch.setattr(version, "source_digests", lambda: found)
    after = layers_of(SETTINGS, PARTS)
    changed = {each for each in Layer if getattr(before, each) != getattr(after, each)}
    assert changed == {layer}
    assert before.pipeline_version != after.pipeline_version


def test_settings_and_parts_are_labels() -> None:
    changed = layers_of(SETTINGS.model_copy(update={"lidar_topic": "/left"}), PARTS)
    before = layers_of(SETTINGS, PARTS)
    assert changed.labels != before.labels
    assert (changed.contradictions, changed.score) == (before.contradictions, before.score)


def test_the_version_is_a_function_of_the_layers() -> None:
    digests = layers_of(SETTINGS, PARTS)
    same = LayerDigests(digests.labels, digests.contradictions, digests.score)
    assert same.pipeline_version == pipeline_version(SETTINGS, PARTS)
    assert len(same.pipeline_version) == 12
