"""The command `obpose-datagen`."""
