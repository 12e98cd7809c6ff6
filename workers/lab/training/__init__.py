"""Training of the supervised stream's networks: data, augmentation, loss, training loop."""
