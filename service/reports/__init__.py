"""Pages of results for people."""
