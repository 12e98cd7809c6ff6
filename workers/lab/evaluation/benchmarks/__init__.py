"""Benchmarks: time per pipeline step, and realism of simulated frames."""
