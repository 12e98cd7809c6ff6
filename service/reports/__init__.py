"""Report pages of results."""
