"""Rigid-body simulation of a scene."""
