"""Bounds of message fields: each integer, float, text and list of a message has one.

A message that exceeds them is refused where it is decoded, with a sentence, before it reaches a
database, a bus key or a page. The bounds are generous: no real log comes near them.
"""

from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator, Field

MAX_INTEGER: Final = 2**63 - 1
"""Largest integer that SQLite, PostgreSQL and an `int64` array keep."""

MAX_TALLY: Final = 2**40
"""Largest count of one scene, shard or plan: eight million of them add up to less than `2**63`."""

MAX_LOG_ID: Final = 1024
"""Characters of a log id; a key of an S3 object has at most 1,024 bytes."""

MAX_TOPIC: Final = 256
"""Characters of an MCAP topic that is mined."""

MAX_NAME: Final = 256
"""Characters of a vehicle, a date, a software version, a worker or a selection."""

MAX_SCENE_ID: Final = MAX_LOG_ID + 3 * MAX_TOPIC + 32
"""Characters of a scene id: log, topic in its encoded form, and start."""

MAX_TEXT: Final = 4096
"""Characters of a sentence in a message between processes, such as the error of a shard."""

MAX_URL: Final = 4096
"""Characters of a URL or of a path."""

MAX_KEPT: Final = 2**20
"""Characters of a text read from a ledger; earlier versions accepted longer texts than this one."""

MAX_BLOB: Final = 2**20
"""Characters of a structured text: a message schema, a map of classes."""

MAX_SCENES_OF_A_SHARD: Final = 20_000
"""Scenes of one shard: an hour of scenes of 0.2 s; and SQLite takes 32,766 values at once."""

MAX_SCENES_ASKED: Final = 10_000_000
"""Rows of the ranking, or scenes of a selection, that one request may ask for."""

MAX_SCENES_CHOSEN: Final = 5_000
"""Scenes that one request may name; ids of up to 200 characters then fit MAX_QUESTION_BYTES."""

MAX_NEWEST: Final = 100_000
"""Scenes that one request for the newest may ask for; the service keeps them all in memory."""

MAX_LISTED: Final = 10_000_000
"""Rows of one reply of the service, which lists the content of its own ledger."""

MAX_CHUNKS: Final = 500_000
"""Byte ranges of a log that one shard reads."""

MAX_PARTS: Final = 100_000
"""Files of one split recording."""

MAX_SHARDS_OF_A_PLAN: Final = 20_000
"""Shards of one log: at 20 s each, more than four days of it."""

MAX_PLAN_BYTES: Final = 64 * 1024 * 1024
"""Bytes of a plan, encoded."""

MAX_COMMIT_BYTES: Final = MAX_PLAN_BYTES + 2**20
"""Bytes of a commit: a plan, or a manifest with all of its records once more."""

MAX_QUESTION_BYTES: Final = 2**20
"""Bytes of any other request."""

MAX_LOGS_NAMED: Final = 10_000
"""Logs that one request may name."""

MAX_KEY_BYTES: Final = 2**16 - 1
"""Bytes of a Zenoh key; the Zenoh binding panics on a longer one and is unusable afterwards."""

Count = Annotated[int, Field(ge=0, le=MAX_INTEGER)]
"""A number of items, or an offset in bytes."""

Tally = Annotated[int, Field(ge=0, le=MAX_TALLY)]
"""A count of one scene, shard or plan, which is added up over all of them."""

Positive = Annotated[int, Field(ge=1, le=MAX_TALLY)]
"""A `Tally` that is not 0."""

StampNs = Annotated[int, Field(ge=0, le=MAX_INTEGER)]
"""Nanoseconds since the Unix epoch, until the year 2262."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A float that is neither infinite nor NaN."""

Seconds = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False)]
"""A duration or an instant in seconds."""

NO_NUL: Final = r"^[^\x00]*$"
"""PostgreSQL keeps no text with a NUL in it."""


def _clip(most: int) -> BeforeValidator:
    """Cut a text that is longer; replace NUL, and halves of surrogate pairs, which UTF-8 lacks."""

    def clip(value: object) -> object:
        if not isinstance(value, str):
            return value
        value = value.replace("\0", " ").encode("utf-8", "replace").decode("utf-8")
        return value if len(value) <= most else f"{value[: most - 1]}~"

    return BeforeValidator(clip)


def _without_nul(text: str) -> str:
    """Refuse a NUL, without the cost of a pattern on each character of a long text."""
    if "\0" in text:
        raise ValueError("a text without NUL is needed")
    return text


LogId = Annotated[str, Field(min_length=1, max_length=MAX_LOG_ID, pattern=NO_NUL)]
Topic = Annotated[str, Field(min_length=1, max_length=MAX_TOPIC, pattern=NO_NUL)]
Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME, pattern=NO_NUL)]
SceneId = Annotated[str, Field(min_length=1, max_length=MAX_SCENE_ID, pattern=NO_NUL)]
Digest = Annotated[str, Field(min_length=1, max_length=128, pattern=NO_NUL)]
Url = Annotated[str, Field(max_length=MAX_URL, pattern=NO_NUL)]
Blob = Annotated[str, Field(max_length=MAX_BLOB), AfterValidator(_without_nul)]
Kept = Annotated[str, Field(max_length=MAX_KEPT)]
Text = Annotated[str, Field(max_length=MAX_TEXT), _clip(MAX_TEXT)]
"""A sentence; a longer one is cut, since an error of a library may quote a whole reply."""

Said = Annotated[str, Field(max_length=MAX_NAME), _clip(MAX_NAME)]
"""A name recorded in a log, such as its vehicle; a longer one is cut."""

MAX_DENSE_BYTES: Final = 2**18
"""Bytes of JSON up to which any message is decoded; decoding takes a few hundred MiB per 4 MiB."""

MIN_BYTES_OF_A_VALUE: Final = 8
"""Mean bytes of JSON per value in any larger message; a reference to a chunk has 19."""

MAX_UNKNOWN_NAMES: Final = 64
"""Unknown field names accepted in a larger message; each produces one validation error."""
