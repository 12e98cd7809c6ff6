"""Simulation, training, calibration and evaluation of the streams; mining never imports it."""
