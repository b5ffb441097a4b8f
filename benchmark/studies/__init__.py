"""Experiments behind docs/results: one module per study, run with `python -m benchmark.studies NAME`.

A study has a docstring, a dataclass `Flags` of its options, and a function `run` that returns the lines of its table or
draws a picture.
"""
