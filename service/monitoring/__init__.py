"""Metrics, gauges, readiness, and their HTTP routes."""
