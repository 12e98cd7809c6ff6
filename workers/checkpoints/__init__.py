"""Checkpoints: weights on disk, validated by name and loaded whole or not at all."""
