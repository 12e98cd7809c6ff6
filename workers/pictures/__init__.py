"""Camera pictures that are kept with the scenes."""
