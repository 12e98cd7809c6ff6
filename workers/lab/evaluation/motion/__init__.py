"""Motion labels against truth, log by log, disturbed or not."""
