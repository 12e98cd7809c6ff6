"""The loop: a model is taught, mines a fleet, is taught on with chosen scenes, and is judged."""
