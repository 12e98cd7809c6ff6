"""Every setting, its default, and where the value that holds comes from."""
