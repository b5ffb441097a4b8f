"""Meshes, signed distances, mass and bounding boxes of shapes."""
