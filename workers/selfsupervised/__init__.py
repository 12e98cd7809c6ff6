"""The self-supervised stream: motion from geometry alone, without labels or trained weights."""
