"""Spinning lidars in a street."""
