"""Work that repeats while the service runs."""
