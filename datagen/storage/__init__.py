"""Dataset files: shards, folders, locks, and safe readers of files from outside."""
