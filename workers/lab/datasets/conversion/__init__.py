"""Conversion of data sets to logs and truth: what readers yield, and what writes it."""
