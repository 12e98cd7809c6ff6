"""Ranking service: collects scene scores, ranks them, and serves selections for review."""
