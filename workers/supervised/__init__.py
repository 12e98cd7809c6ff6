"""The supervised stream: what networks trained on labels say about the motion of every point."""
