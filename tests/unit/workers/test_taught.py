"""Weights that the self-supervised stream taught are named in versions, records and remarks."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from schemas.score import TAUGHT, is_taught
from tests.labelled_worlds import CLASS_NAMES, labelled_scene, shard_of
from tests.unit.service.test_picture import _Streams as Streams
from tests.unit.workers.test_rescoring import MISSED, PHANTOM, WALL
from workers.checkpoints.devices import device_of
from workers.checkpoints.errors import WeightsUnusableError
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.instances import find_instances
from workers.contradiction.reasons import TAUGHT_REMARK
from workers.contradiction.rescoring import rescored
from workers.contradiction.scene_statistics import statistics_of
from workers.contradiction.score import score_scene
from workers.contradiction.scoring_inputs import decode_inputs, encode_inputs, inputs_of
from workers.contradiction.track_score import rank_tracks
from workers.contradiction.tracks import associate_instances
from workers.parts.files import PartFiles
from workers.parts.registry import build_supervised
from workers.supervised.stream import SHIPPED, RangeImageStream


@dataclass(frozen=True)
class _Named:
    version: str


def _taught_weights(folder: Path) -> Path:
    shutil.copytree(SHIPPED, folder)
    card = json.loads((folder / "lmnet.json").read_text())
    (folder / "lmnet.json").write_text(json.dumps(card | {"teacher": "selfsupervised"}))
    return folder


def test_a_stream_of_taught_weights_says_so_in_its_version(tmp_path: Path) -> None:
    shipped = RangeImageStream.salsanext_lmnet(SHIPPED)
    assert not is_taught(shipped.version)
    taught = RangeImageStream.salsanext_lmnet(_taught_weights(tmp_path / "w"))
    assert taught.version.startswith(f"salsanext-lmnet{TAUGHT}@")
    assert not is_taught(RangeImageStream.salsanext_ground(tmp_path / "w").version)


def test_the_record_of_a_taught_stream_says_so_and_attributes_nothing() -> None:
    scene = labelled_scene([WALL, MISSED, PHANTOM], frames=12)
    instances = find_instances(scene, class_names=CLASS_NAMES)
    described = extract_features(scene, instances, associate_instances(scene, instances))
    streams = Streams()
    records = {}
    for name in ("salsanext-lmnet@1", f"salsanext-lmnet{TAUGHT}@1"):
        object.__setattr__(streams, "supervised", _Named(name))
        ranked = rank_tracks(scene, described, attribute_tracks(described, taught=is_taught(name)))
        score = score_scene(
            *(shard_of(), scene, instances, ranked), parts=streams, pipeline_version="abcdef012345"
        )
        inputs = inputs_of(
            *(score, scene, instances, described, statistics_of(scene)), own_model=""
        )
        assert rescored(decode_inputs(encode_inputs(inputs))) == score
        records[is_taught(name)] = score
    assert all(track.attribution is not None for track in records[False].tracks)
    assert all(track.attribution is None for track in records[True].tracks)
    assert records[True].reasons[-1].headline == TAUGHT_REMARK
    assert TAUGHT_REMARK not in [reason.headline for reason in records[False].reasons]
    assert records[True].score > 0
    assert records[True].producers.taught


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_without_a_gpu_auto_is_the_processor_and_cuda_a_sentence() -> None:
    assert device_of("auto") == device_of("cpu") == "cpu"
    with pytest.raises(WeightsUnusableError, match="finds no GPU"):
        device_of("cuda")
    streams = [
        build_supervised("salsanext-lmnet", PartFiles(device=name)) for name in ("auto", "cpu")
    ]
    assert streams[0].version == streams[1].version
    with pytest.raises(WeightsUnusableError, match="set device to auto or cpu"):
        build_supervised("salsanext-lmnet", PartFiles(device="cuda"))
