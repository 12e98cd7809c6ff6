"""Logs and truth, as files or in memory."""
