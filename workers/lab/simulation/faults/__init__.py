"""Failures of the model on the car, and disturbances, planted on purpose."""
