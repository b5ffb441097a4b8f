"""The report of a run folder: one HTML page to look at, offline, with scores, slices, errors, costs and pictures."""

from benchmark.report.page import write

__all__ = ["write"]
