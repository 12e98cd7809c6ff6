"""Selection strategies: which scenes of the ranking go to the labellers; pure."""
