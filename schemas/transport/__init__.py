"""Buckets, the bus and the encodings that records travel in."""
