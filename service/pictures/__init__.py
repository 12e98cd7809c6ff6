"""Pictures of scenes and of evaluations."""
