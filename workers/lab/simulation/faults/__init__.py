"""Fault injection: planted failures of the on-board model, and disturbances of the recording."""
