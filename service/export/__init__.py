"""Formats in which a selection leaves the house; pure."""
