"""Periodic work of a running service."""
