"""Finished labels of exported scenes, by format: a file each, read back to the exported points."""
