"""Training images of simulated streets and real logs."""
