"""Weights on disk: read, checked by name, and loaded whole or not at all; below every stage."""
