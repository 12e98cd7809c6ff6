"""Client of Prometheus and of a service, for the queries of the panels."""

import json
from contextlib import closing
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from typing import Any
from urllib.parse import urlencode


class AnswerError(Exception):
    """A query that was not answered; the message contains query and answer."""


@dataclass(frozen=True, slots=True)
class Series:
    """One line: labels, and pairs of time (seconds since the epoch) and value."""

    labels: dict[str, str]
    samples: tuple[tuple[float, float], ...]


def get(address: str, path: str, **parameters: str) -> str:
    """Return the body of a page.

    Args:
        address: `host:port`.
        path: With or without parameters of its own.
        parameters: Further parameters.

    Raises:
        AnswerError: If the address does not answer, or the status is not 200.
    """
    question = f"{path}?{urlencode(parameters)}" if parameters else path
    try:
        with closing(HTTPConnection(address, timeout=30)) as connection:
            connection.request("GET", question)
            response = connection.getresponse()
            body = response.read().decode()
    except (OSError, HTTPException, UnicodeError) as error:
        raise AnswerError(f"{address} does not answer: {error}") from error
    if response.status != 200:
        raise AnswerError(f"{address}{question}: {response.status} {body}")
    return body


def query_range(
    prometheus: str, expr: str, *, start_s: float, end_s: float, step_s: float
) -> list[Series]:
    """Evaluate an expression over a time range; values that are not numbers are left out.

    Args:
        prometheus: `host:port`.
        expr: PromQL.
        start_s: First instant, seconds since the epoch.
        end_s: Last one.
        step_s: Interval between two of them, seconds.

    Raises:
        AnswerError: If Prometheus refuses the expression.
    """
    answer = _data(
        prometheus, "/api/v1/query_range", query=expr, start=start_s, end=end_s, step=step_s
    )
    return [_series(one["metric"], one["values"]) for one in answer["result"]]


def query(prometheus: str, expr: str, *, at_s: float) -> list[Series]:
    """Evaluate an expression at one instant."""
    answer = _data(prometheus, "/api/v1/query", query=expr, time=at_s)
    return [_series(one["metric"], [one["value"]]) for one in answer["result"]]


def rates(service: str, path: str) -> list[dict[str, Any]]:
    """Query the rates of a service.

    Raises:
        AnswerError: If it does not answer, or refuses the query.
    """
    rows: list[dict[str, Any]] = _json(service, path)
    return rows


def _data(prometheus: str, path: str, **parameters: str | float) -> dict[str, Any]:
    asked = {name: str(value) for name, value in parameters.items()}
    answer: dict[str, Any] = _json(prometheus, path, **asked)["data"]
    return answer


def _json(address: str, path: str, **parameters: str) -> Any:
    body = get(address, path, **parameters)
    try:
        return json.loads(body)
    except ValueError as error:
        raise AnswerError(f"{address}{path} answers with no JSON: {body[:80]!r}") from error


def _series(labels: dict[str, str], values: list[tuple[float, str]]) -> Series:
    numbers = ((float(at_s), float(value)) for at_s, value in values)
    return Series(labels, tuple((at_s, value) for at_s, value in numbers if value == value))
