"""Streets that never were, driven through with a spinning lidar and written as logs with truth."""
