"""Where the two streams contradict each other: points, instances, tracks, scores, overlays."""
