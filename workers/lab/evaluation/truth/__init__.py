"""Ground truth of a log, and the coarse classes of its evaluation."""
