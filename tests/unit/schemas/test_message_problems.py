"""The sentence about an invalid message, whatever the message contains."""

import json

import pytest
from pydantic import ValidationError

from schemas.transport.wire import MOST_OF_A_PROBLEM, decode, first_problem
from schemas.work import ClaimReply


def problem_of(kind: str) -> str:
    with pytest.raises(ValidationError) as refused:
        decode(ClaimReply, json.dumps({"grant": {"kind": kind}}).encode())
    return first_problem(refused.value)


def test_control_characters_of_a_message_are_escaped() -> None:
    said = problem_of("\n\r\t\x1b[31m\u202e")
    assert said.startswith(r"grant: Input tag '\n\r\t\x1b[31m\u202e' found using 'kind'")
    assert said.isprintable()


def test_a_long_value_is_cut() -> None:
    assert len(problem_of("x" * 10_000)) == MOST_OF_A_PROBLEM
