"""Metrics of label maps, exact and fast; `score` is what most callers need, `clip_scores` what the harness keeps."""

from benchmark.metrics.score import (
    CLIP_METRICS,
    METRICS,
    ClipScores,
    FrameScores,
    clip_scores,
    frame_scores,
    mean_where_defined,
    score,
    summarise,
)

__all__ = [
    "CLIP_METRICS",
    "METRICS",
    "ClipScores",
    "FrameScores",
    "clip_scores",
    "frame_scores",
    "mean_where_defined",
    "score",
    "summarise",
]
