"""Experiments behind the published results."""
