"""Lidar simulation: drives through synthetic streets, written as logs with ground truth."""
