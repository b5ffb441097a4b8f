"""Own RGB-D frames: read them as model input, and write segmentations to files."""
