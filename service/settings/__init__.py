"""Settings, their defaults, and the source of each value."""
