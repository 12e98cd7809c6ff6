"""What a lidar saw: beams, range images, deskewing, ground, preparation of a frame."""
