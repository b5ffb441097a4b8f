"""Layers that several parts of the model are made of."""
