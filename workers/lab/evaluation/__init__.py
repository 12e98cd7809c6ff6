"""Evaluation of the streams: labels against ground truth, and time per pipeline step."""
