"""Metrics, gauges, readiness, and the HTTP routes that show them."""
