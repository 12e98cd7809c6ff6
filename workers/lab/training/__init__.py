"""What makes the networks of the supervised stream: data, augmentation, loss, the training loop."""
