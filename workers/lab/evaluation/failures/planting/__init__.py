"""Planting: failures planted by seed into labels that are made from the truth of real drives."""
