"""Replaceable parts of the pipeline: protocols, registry, catalogue, files, networks."""
