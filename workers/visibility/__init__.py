"""What beams saw: beams, range images, and which places were seen through; no stage of its own."""
