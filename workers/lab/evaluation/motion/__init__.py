"""Motion evaluation: motion labels against truth per log, optionally with degraded input."""
