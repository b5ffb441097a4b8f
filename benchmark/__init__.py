"""Metrics, baselines and tables for unsupervised scene segmentation."""
