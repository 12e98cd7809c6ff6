"""Compilation of loops ahead of time, in a process of its own."""
