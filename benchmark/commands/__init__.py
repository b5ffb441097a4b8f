"""The command `obpose-bench`."""
