"""Boxes that the model on the car recorded: messages, files, and their place in the lidar's space.

`source` finds them in a log, `stated` reads a message, `spaces` places it, `pairing` gives each
cloud its answer, and `prediction_files` reads what is next to a log.
"""
