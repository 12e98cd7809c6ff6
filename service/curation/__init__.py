"""Ranking, selection, rates and names of scenes: no SQL, no bus, no web."""
