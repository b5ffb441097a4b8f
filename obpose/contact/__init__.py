"""Segmentation learned from pasted contacts: training images, network, losses, grouping, and tracking over a clip."""
