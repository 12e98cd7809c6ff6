"""Which form of a published rule: as its code does it, or with its faults mended."""

from enum import StrEnum


class Form(StrEnum):
    """How close a part stays to the published code.

    CORRECTED: what the rule is meant to do; the docstring of each part names what differs.
    PAPER: bug for bug, for the paper's own numbers and for networks trained behind the bug.
    """

    CORRECTED = "corrected"
    PAPER = "paper"
