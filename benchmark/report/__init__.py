"""The report of a run folder: one offline HTML page with scores, slices, errors, costs and pictures."""

from benchmark.report.page import write

__all__ = ["write"]
