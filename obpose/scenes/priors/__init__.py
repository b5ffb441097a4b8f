"""Priors over scenes, and sampling from them."""
