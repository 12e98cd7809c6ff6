"""Fidelity to a published rule: its code bug for bug, or with its faults corrected."""

from enum import StrEnum


class Form(StrEnum):
    """Fidelity of a part to the published code.

    CORRECTED: the intended rule; the docstring of each part names the differences.
    PAPER: bug for bug, for the paper's own numbers and for networks trained with the bug.
    """

    CORRECTED = "corrected"
    PAPER = "paper"
