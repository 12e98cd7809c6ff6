"""Ingest: lidar frames from the MCAP logs of a bucket; no other package knows MCAP."""
