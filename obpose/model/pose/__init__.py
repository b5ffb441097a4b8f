"""Boxes of the objects: location, orientation, and encoders of the points inside."""
