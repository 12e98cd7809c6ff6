"""Shapes of everything that a street holds."""
