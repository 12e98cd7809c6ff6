"""Bucket in, scene scores out."""
