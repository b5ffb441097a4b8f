"""Parts of the training loop in `obpose.training.loop`."""
