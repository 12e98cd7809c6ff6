"""What judges the streams: labels against truth, and where the time of the pipeline goes."""
