"""Parts of the training loop in `obpose.train`."""
