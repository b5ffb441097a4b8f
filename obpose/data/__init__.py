"""Clips as tensors, for training and inference."""
