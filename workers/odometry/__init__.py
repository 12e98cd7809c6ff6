"""Poses of the sensor, and tests whether they can be trusted: KISS-ICP under guard."""
