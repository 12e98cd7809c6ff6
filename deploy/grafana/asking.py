"""Asks a Prometheus and a service what the panels ask them."""

import json
from dataclasses import dataclass
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlencode


class AnswerError(Exception):
    """A question that was not answered; the message holds question and answer."""


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
        parameters: More of them.

    Raises:
        AnswerError: If the status is not 200.
    """
    question = f"{path}?{urlencode(parameters)}" if parameters else path
    connection = HTTPConnection(address, timeout=30)
    try:
        connection.request("GET", question)
        response = connection.getresponse()
        body = response.read().decode()
    finally:
        connection.close()
    if response.status != 200:
        raise AnswerError(f"{address}{question}: {response.status} {body}")
    return body


def query_range(
    prometheus: str, expr: str, *, start_s: float, end_s: float, step_s: float
) -> list[Series]:
    """Evaluate an expression over a time range; without values that are no number.

    Args:
        prometheus: `host:port`.
        expr: PromQL.
        start_s: First instant, seconds since the epoch.
        end_s: Last one.
        step_s: Between two of them.

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
    """Ask the store of a service for rows."""
    rows: list[dict[str, Any]] = json.loads(get(service, path))
    return rows


def _data(prometheus: str, path: str, **parameters: str | float) -> dict[str, Any]:
    asked = {name: str(value) for name, value in parameters.items()}
    answer: dict[str, Any] = json.loads(get(prometheus, path, **asked))["data"]
    return answer


def _series(labels: dict[str, str], values: list[tuple[float, str]]) -> Series:
    numbers = ((float(at_s), float(value)) for at_s, value in values)
    return Series(labels, tuple((at_s, value) for at_s, value in numbers if value == value))
