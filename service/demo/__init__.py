"""The demo: a small simulated fleet, mined and ranked, with pictures."""
