"""Excerpts of logs around scenes: cut byte for byte, and written as MCAP."""
