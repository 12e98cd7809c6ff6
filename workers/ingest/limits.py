"""Limits of planning and reading: memory, opened bytes and work that one log can cost.

A file of some kilobytes can claim to grow to gigabytes, or to last for centuries. Beyond each
limit its part is damage, or the log is refused, in one sentence. Real logs stay far below all of
them.
"""

from typing import Final

MIB: Final = 1024 * 1024

MAX_CHUNK_BYTES: Final = 128 * MIB
"""Bytes of an opened chunk, and of a stored one; writers produce 0.75 to 8 MiB."""

MAX_CHUNK_RECORDS: Final = 500_000
"""Records in a chunk; 8 MiB of the shortest messages are 270,000."""

MAX_CHUNKS: Final = 150_000
"""Chunks of a recording, 2 kB of memory each; 110 GB of the writers' smallest."""

MAX_SUMMARY_RECORDS: Final = 500_000
"""Records of a summary, of all kinds."""

MAX_COUNTED: Final = 2_000_000
"""Channels of all chunks of a summary together, about 100 bytes of memory each."""

MAX_SMALL_BYTES: Final = MIB
"""Bytes of a channel, chunk index or statistics record; counts of 65,536 channels take 0.6 MiB."""

MAX_SCHEMA_BYTES: Final = 16 * MIB
"""Bytes of a schema or metadata record."""

MAX_SCHEMA_TEXT: Final = MIB
"""Characters, in base64, of a schema or of the classes of recorded labels in messages."""

MAX_IDS: Final = 100_000
"""Channels of one topic, in all parts together."""

MAX_CHANNELS_BYTES: Final = 16 * MIB
"""Bytes of all channel records of a part, which take 15 times as much memory."""

MAX_SCHEMAS_BYTES: Final = 64 * MIB
"""Bytes of all schema records of a part."""

MAX_METADATA_BYTES: Final = 16 * MIB
"""Bytes of all metadata records of a part that are read."""

MAX_RECORDS_HOPPED: Final = 10_000_000
"""Records, and candidates for one, that are examined in a part without an index: 30 s."""

MAX_OPENED_BYTES: Final = 2048 * MIB
"""Opened bytes of the chunks that planning opens; usually two or three chunks of some MiB."""

MAX_STORED_BYTES: Final = 512 * MIB
"""Stored bytes of the chunks that planning opens."""

MAX_RECORDS_OPENED: Final = 2_000_000
"""Records of the chunks that planning opens: about 10 s."""

MAX_HELD_BYTES: Final = 64 * MIB
"""Bytes of opened chunks that planning keeps for the next topic; beyond, it opens them again."""

MAX_SAMPLE_BYTES: Final = 192 * MIB
"""Bytes of the clouds by which planning classifies all lidars."""

MAX_CLOUD_TOPICS: Final = 64
"""Topics of clouds that planning samples; a car has ten, and their copies."""

MAX_TRIED: Final = 1_000
"""Messages of one topic among which planning looks for a readable cloud."""

MAX_READ_TIMES: Final = 64
"""Bytes that a log's shards may read together, as a multiple of its own; usually 1.1."""

FREE_READ_BYTES: Final = 1024 * MIB
"""Bytes that the shards of any log may read together, however small it is."""

MAX_CHUNKS_OF_SHARDS: Final = 500_000
"""Chunks of all shards together, repetitions included: 64 MiB of plan."""

MAX_DAMAGE: Final = 1_000
"""Stretches of damage that a plan or a shard names; the rest is one entry with their number."""

MAX_CLOUD_BYTES: Final = 64 * MIB
"""Bytes of a message of points or of an image; 2 million points of 32 bytes."""

MAX_JSON_BYTES: Final = 16 * MIB
"""Bytes of a message in JSON, which takes 25 times as much memory."""

MAX_OTHER_BYTES: Final = 4 * MIB
"""Bytes of any other message: transforms, calibrations, motion."""

MAX_FIELDS: Final = 1_000
"""Fields of a cloud; drivers write 4 to 15."""

MAX_POINTS: Final = 2_000_000
"""Points of a cloud; the densest lidar on a car has 524,288 (128 by 2,048, two returns)."""

MAX_LOGGED_PER_S: Final = 1_000
"""Clouds of a lidar logged in a second; a delayed recorder writes many at once."""

MAX_CLOUDS_PER_S: Final = 200
"""Clouds of a lidar in a second of its stamps; lidars turn 5 to 50 times."""

MAX_POINTS_PER_S: Final = 8_000_000
"""Points of a lidar in a second of its stamps; the densest has 6.9 million."""

MAX_WAITING_BYTES: Final = 128 * MIB
"""Bytes of messages held back until no earlier one can come; beyond, they leave unsorted."""

MAX_WAITING: Final = 100_000
"""Messages held back until no earlier one can come."""

MAX_AHEAD_BYTES: Final = 32 * MIB
"""Bytes of a stored or opened chunk up to which it is opened ahead of its use."""

MAX_WAITING_POINTS: Final = 4_000_000
"""Points of the clouds that wait for their recorded labels."""

MAX_MOMENT_BYTES: Final = 256 * MIB
"""Bytes of images, transforms and calibrations around one moment."""
