"""Output of the simulation: logs, truth and training samples, as files or in memory."""
