"""Scene scores in, a reviewed selection out."""
