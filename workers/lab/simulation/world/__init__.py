"""Street world: roads, ground, scenery, traffic, weather, and the ego's drive."""
