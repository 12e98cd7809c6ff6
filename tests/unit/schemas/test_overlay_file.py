import json
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any
from zlib import crc32

import numpy as np
import pytest
import zstandard

from schemas.overlay import Overlay
from schemas.transport.array_pack import PackUnreadableError
from schemas.transport.overlay_codec import decode_overlay, encode_overlay, overlay_file_of
from schemas.transport.overlay_file import OverlayIsVersion1Error, open_overlay_file
from schemas.transport.overlay_header import BEGIN, OVERLAY_MAGIC, encoded_header
from tests.unit.schemas.test_overlay import _overlay
from workers.lab.evaluation.benchmarks.bench_overlay import encode_version_1


def _reader(payload: bytes) -> tuple[Callable[[int, int], bytes], list[tuple[int, int]]]:
    asked: list[tuple[int, int]] = []

    def read(offset: int, length: int) -> bytes:
        asked.append((offset, length))
        return payload[offset : offset + length]

    return read, asked


def _changed(
    payload: bytes, change: Callable[[dict[str, Any]], None], *, more: bytes = b""
) -> bytes:
    """The file with a changed header, whose offsets begin at its blocks, and more bytes behind."""
    _, length, _ = BEGIN.unpack_from(payload)
    header = json.loads(payload[BEGIN.size : BEGIN.size + length])
    blocks = payload[BEGIN.size + length :] + more
    _shift(header, -BEGIN.size - length)
    change(header)

    def header_at(begin: int) -> dict[str, Any]:
        moved: dict[str, Any] = deepcopy(header)
        _shift(moved, begin)
        return moved

    return encoded_header(header_at) + blocks


def _shift(header: dict[str, Any], by: int) -> None:
    places = [header["inputs"]] if "inputs" in header else []
    places += [frame[name] for frame in header.get("frames", ()) for name in ("view", "rest")]
    places += [picture["block"] for picture in header.get("pictures", ())]
    for place in places:
        place[0] += by


def test_a_frame_is_read_alone_and_as_stored() -> None:
    payload = encode_overlay(_overlay(points=30_000))
    read, asked = _reader(payload)
    file = open_overlay_file(read, file_bytes=len(payload))
    assert asked == [(0, 65_536)], "one read for the header"
    entry = file.header.frames[1]
    block = file.view(1)
    assert asked[1:] == [entry.view]
    assert block == payload[entry.view[0] : sum(entry.view)]
    assert len(zstandard.decompress(block)) == 9 * 30_000 + 3_750 + 4
    assert file.picture(0).startswith(b"\xff\xd8")
    assert file.scoring_inputs() == b"{}{}"
    assert json.loads(file.header_json)["frames"][1]["stamp_ns"] == "1700000000100000000"


def test_the_layout_of_a_view_block_is_what_a_browser_reads() -> None:
    overlay = _overlay(points=21)
    raw = np.frombuffer(
        zstandard.decompress(overlay_file_of(encode_overlay(overlay)).view(0)), "u1"
    )
    folded = (raw[0:21].astype(int) + 256 * raw[21:42].astype(int)).astype(np.int32)
    x_cm = np.cumsum((folded >> 1) ^ -(folded & 1)).astype(np.int16)
    np.testing.assert_array_equal(x_cm, overlay.points_cm[:21, 0])
    four = np.where(overlay.semantic_labels[:21] == 2, 15, overlay.semantic_labels[:21])
    np.testing.assert_array_equal(raw[126:147] & 15, four)
    four = np.where(overlay.predictive_labels[:21] == 2, 15, overlay.predictive_labels[:21])
    np.testing.assert_array_equal(raw[126:147] >> 4, four)
    np.testing.assert_array_equal(raw[147:168].view(np.int8), overlay.class_id[:21])
    four = np.where(overlay.witness_labels[:21] == 2, 15, overlay.witness_labels[:21])
    np.testing.assert_array_equal(raw[168:189], four)
    np.testing.assert_array_equal(np.unpackbits(raw[189:192])[:21], overlay.ground_mask[:21])
    listed = np.flatnonzero(overlay.instance_index[:21] >= 0)
    assert int(raw[192:196].view("<u4")[0]) == len(listed)
    np.testing.assert_array_equal(raw[196 : 196 + 4 * len(listed)].view("<u4"), listed)


def test_an_overlay_of_version_1_is_served_as_one_of_version_2() -> None:
    before = _overlay()
    payload = encode_version_1(before)
    read, _ = _reader(payload)
    with pytest.raises(OverlayIsVersion1Error, match=r"version 1, whose frames .* \(a/b\)$"):
        open_overlay_file(read, file_bytes=len(payload), where="a/b")
    file = overlay_file_of(payload)
    assert [frame.points for frame in file.header.frames] == [700, 700]


def _grow(header: dict[str, Any]) -> None:
    header["frames"][0]["points"] = 2**29


def _beyond(header: dict[str, Any]) -> None:
    header["inputs"] = [10**8, 10]


def _other_frame(header: dict[str, Any]) -> None:
    header["pictures"][0]["frame"] = 2


def _uneven(header: dict[str, Any]) -> None:
    header["instances"]["track"].append(0)


def _late(header: dict[str, Any]) -> None:
    header["frames"][0]["stamp_ns"] = "9999999999999999999"


def _elsewhere(header: dict[str, Any]) -> None:
    header["frames"][0]["view"] = list(header["frames"][0]["rest"])
    header["frames"][0]["view_crc32"] = header["frames"][0]["rest_crc32"]


def _more_classes(header: dict[str, Any]) -> None:
    header["class_names"] = []


def _other_task(header: dict[str, Any]) -> None:
    header["task"] = "weather"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_grow, "claims .* points, more than any overlay has|damaged"),
        (_beyond, "damaged: a block ends beyond"),
        (_other_frame, "a picture of a frame it does not have"),
        (_uneven, "instances of different numbers"),
        (_late, "not a well-formed overlay"),
        (_elsewhere, "damaged: 1400 bytes for a frame of 700 points"),
        (_more_classes, "not a well-formed overlay: class_id must lie in"),
        (_other_task, "not a well-formed overlay: no task 'weather'"),
        (dict.clear, "not a well-formed overlay: scene_id: Field required"),
    ],
)
def test_a_lying_header_is_refused_with_one_sentence(
    change: Callable[[dict[str, Any]], None], says: str
) -> None:
    payload = _changed(encode_overlay(_overlay()), change)
    with pytest.raises(PackUnreadableError, match=says) as caught:
        decode_overlay(payload, where="file:///a")
    assert str(caught.value).count("the overlay is unreadable: ") == 1
    assert str(caught.value).endswith("(file:///a)")


def test_a_header_that_claims_more_than_the_file_is_refused() -> None:
    payload = BEGIN.pack(OVERLAY_MAGIC, 2**31, 0)
    with pytest.raises(PackUnreadableError, match="claims a header of 2147483648 bytes in 16"):
        decode_overlay(payload)


def test_a_block_that_claims_gigabytes_is_refused_before_it_is_decompressed() -> None:
    bomb = b"\x28\xb5\x2f\xfd\xe0" + (8 * 2**30).to_bytes(8, "little") + b"\x01\0\0"
    payload = encode_overlay(_overlay())

    _, length, _ = BEGIN.unpack_from(payload)

    def point_at(header: dict[str, Any]) -> None:
        at = len(payload) - BEGIN.size - length
        header["frames"][0] |= {"view": [at, len(bomb)], "view_crc32": crc32(bomb)}

    longer = _changed(payload, point_at, more=bomb)
    with pytest.raises(PackUnreadableError, match="claims 8589934592 bytes, more than"):
        decode_overlay(longer)


def test_a_header_of_any_length_points_at_its_blocks() -> None:
    """The offsets are numbers in the header, whose digits change its length."""
    base = _overlay(points=3, instances=0)
    for length in range(60, 180):
        overlay: Overlay = replace(base, scene_id="s" * length)
        again = decode_overlay(encode_overlay(overlay))
        np.testing.assert_array_equal(again.points_cm, overlay.points_cm)
