"""Models: triangle meshes of everything in a street."""
