"""Failure retrieval: measures how well contradictions rank the supervised stream's failures."""
