"""Odometry evaluation: relative pose errors against truth, with floors."""
