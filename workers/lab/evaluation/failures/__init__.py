"""Whether what contradicts is what fails: retrieval of the supervised stream's failures."""
