"""A user's own RGB-D frames: files to observations, and what a model finds in them to files."""
