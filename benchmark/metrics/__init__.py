"""Metrics of label maps, exact and fast; `score` is all that most callers need."""

from benchmark.metrics.score import METRICS, FrameScores, frame_scores, score, summarise

__all__ = ["METRICS", "FrameScores", "frame_scores", "score", "summarise"]
