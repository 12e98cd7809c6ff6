"""Lidar frames: beams, range images, deskewing, ground removal and preprocessing."""
