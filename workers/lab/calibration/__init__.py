"""Sensor calibration: measures the layout of a lidar before a model is trained or used for it."""
