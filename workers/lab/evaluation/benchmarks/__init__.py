"""Where time goes, and how like real frames simulated ones are."""
