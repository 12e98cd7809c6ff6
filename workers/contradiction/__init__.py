"""Contradictions of the two streams: points, instances, tracks, scores and overlays."""
