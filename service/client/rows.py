"""Rows of an answer, as a sequence and as a table of pandas."""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar, overload

from pydantic import BaseModel

from service.errors import UsageError

if TYPE_CHECKING:
    import pandas

Row = TypeVar("Row", bound=BaseModel)

SHOWN: Final = 3
"""Rows that the text of an answer shows."""

NEEDS_PANDAS: Final = "to_dataframe needs pandas: pip install 'counterpoint[notebook]'"


class Rows(Sequence[Row], Generic[Row]):
    """Rows of an answer; those of a paged one are fetched page by page when they are needed."""

    def __init__(self, pages: Callable[[], Iterator[Sequence[Row]]]) -> None:
        """Keep the function that fetches the pages."""
        self._pages, self._kept = pages(), list[Row]()

    @overload
    def __getitem__(self, index: int) -> Row: ...

    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...

    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        """Return a row, or some of them."""
        stop = index.stop if isinstance(index, slice) else index + 1
        self._fetch(None if stop is None or stop <= 0 else stop)
        return self._kept[index]

    def __iter__(self) -> Iterator[Row]:
        """Yield every row."""
        at = 0
        while self._fetch(at + 1) > at:
            yield self._kept[at]
            at += 1

    def __len__(self) -> int:
        """Return the number of rows; fetches them all."""
        return self._fetch(None)

    def __repr__(self) -> str:
        """Return the first rows as text."""
        some = self[: SHOWN + 1]
        more = ", ..." if len(some) > SHOWN else ""
        return f"Rows([{', '.join(map(repr, some[:SHOWN]))}{more}])"

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return the rows as a table; a field of a nested record is a column `field.inner`.

        Raises:
            UsageError: If pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise UsageError(NEEDS_PANDAS) from None
        rows = [_flat(row.model_dump(mode="json")) for row in self]
        return pandas.DataFrame(rows)

    def _fetch(self, wanted: int | None) -> int:
        """Fetch pages until there are enough rows, None: all; return how many there are."""
        while wanted is None or len(self._kept) < wanted:
            page = next(self._pages, None)
            if page is None:
                break
            self._kept.extend(page)
        return len(self._kept)


def rows_of(rows: Sequence[Row]) -> Rows[Row]:
    """Return the rows of an answer that has no pages."""
    return Rows(lambda: iter([rows]))


def _flat(record: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat
