"""Ahead-of-time compilation of the loops, in a process of its own."""
