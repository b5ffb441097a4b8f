"""From point embeddings to soft masks of the background and the objects."""
