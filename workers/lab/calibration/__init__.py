"""What is measured of a sensor before a model for it can be trained or used."""
