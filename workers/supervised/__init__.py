"""Supervised stream: networks trained on labels that label the motion of every point."""
