"""Bucket in, lidar frames out: all MCAP knowledge lives here."""
