"""Evaluation of selections and failure modes on mined fleets whose planted failures are known."""
