"""Classes of the supervised stream against truth."""
