"""Labels of a model on the car, as real ones err: noise for simulated and for planted labels."""
