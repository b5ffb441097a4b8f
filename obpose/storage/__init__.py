"""Checkpoints and other files of models."""
