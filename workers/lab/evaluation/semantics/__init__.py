"""Semantic evaluation: classes of the supervised stream against ground truth."""
