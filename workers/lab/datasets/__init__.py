"""Training images from simulated streets and from real logs."""
