"""Lidar sensor models in a simulated street."""
