"""Lidar odometry: KISS-ICP with checks of every pose."""
