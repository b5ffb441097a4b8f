"""Synthetic RGB-D scenes of objects on a table, with exact labels."""
