"""Lower bounds of the mining time: libraries and networks alone, timed per frame."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from time import perf_counter
from typing import Any, Final

import numpy as np

from schemas.frame import LidarFrame
from schemas.transport.bucket import Bucket
from schemas.work import Recording, Shard
from workers.ingest.chunk import messages_in, open_chunk
from workers.ingest.part_reader import PartReader
from workers.ingest.topics import ids_in
from workers.lidar.ground import ground_mask
from workers.lidar.range_image import CHANNELS, image_channels, project
from workers.lidar.sensor_height import estimate_sensor_height
from workers.lidar.sensor_rows import lay_out

MS_PER_S: Final = 1000.0


def reading_ms(bucket: Bucket, recording: Recording, shard: Shard) -> Iterator[float]:
    """Time range read, CRC, decompression and iteration over messages, without decoding.

    Yields:
        Milliseconds of each lidar message; messages of one chunk share its time evenly.
    """
    readers = [PartReader(bucket, part, n) for n, part in enumerate(recording.parts)]
    for ref in shard.chunks:
        started = perf_counter()
        reader = readers[ref.part]
        records = open_chunk(reader.read(ref.offset, ref.length), ref, key=reader.key)
        messages = sum(1 for _ in messages_in(records, ids_in(shard.lidar, ref.part)))
        took_ms = (perf_counter() - started) * MS_PER_S
        yield from [took_ms / max(messages, 1)] * messages


def kiss_icp_ms(
    frames: Iterable[LidarFrame], clock: Callable[[], float] = perf_counter
) -> Iterator[float]:
    """Time plain KISS-ICP: every point, voxels of 1 m, 100 m, no deskewing, one thread."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.mapping.voxel_size = 1.0
    config.data.max_range = 100.0
    config.data.deskew = False
    config.registration.max_num_threads = 1
    kiss = KissICP(config)
    for frame in frames:
        points = frame.points_m[frame.valid_mask].astype(np.float64)
        started = clock()
        kiss.register_frame(points, np.empty(0))
        yield (clock() - started) * MS_PER_S


def patchwork_ms(
    frames: Iterable[LidarFrame], clock: Callable[[], float] = perf_counter
) -> Iterator[float]:
    """Time ground removal with the pipeline's parameters."""
    sensor_height_m: float | None = None
    for frame in frames:
        points = frame.points_m[frame.valid_mask]
        if sensor_height_m is None:
            sensor_height_m = estimate_sensor_height(points)
        started = clock()
        ground_mask(points, sensor_height_m=sensor_height_m)
        yield (clock() - started) * MS_PER_S


def networks_ms(frames: Sequence[LidarFrame]) -> Iterator[float]:
    """Time the forward passes of the shipped SalsaNext and LMNet on prepared images, one thread."""
    # imported here, so that the other lower bounds run without torch in memory
    import torch

    from workers.supervised.stream import SHIPPED
    from workers.supervised.weights import load_weights

    torch.set_num_threads(1)
    semantic = load_weights(SHIPPED / "salsanext.safetensors")
    motion = load_weights(SHIPPED / "lmnet.safetensors")
    past = len(motion.card.residual.ages_s) if motion.card.residual is not None else 0
    for frame in frames:
        profile = lay_out(semantic.card.profile, frame)
        image = project(frame.points_m, profile, valid_mask=frame.valid_mask)
        channels = image_channels(image, frame.points_m, frame.intensity, profile)
        channels = channels[[CHANNELS.index(each) for each in semantic.channels]]
        residuals = np.zeros((past, *channels.shape[1:]), dtype=np.float32)
        inputs = [_tensor(channels), _tensor(np.concatenate((channels, residuals)))]
        started = perf_counter()
        with torch.inference_mode():
            for net, x in zip((semantic.net, motion.net), inputs, strict=True):
                net(x)
        yield (perf_counter() - started) * MS_PER_S


def _tensor(channels: Any) -> Any:
    import torch

    return torch.from_numpy(channels)[None].contiguous(memory_format=torch.channels_last)
