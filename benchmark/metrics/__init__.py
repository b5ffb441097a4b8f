"""Metrics of label maps, exact and fast; `score` is what most callers need, `clip_scores` what the harness keeps."""

from benchmark.metrics.score import (
    CLIP_METRICS,
    METRICS,
    OTHER_METRICS,
    ClipScores,
    CountedClip,
    FrameScores,
    clip_scores,
    clip_scores_of,
    count_clip,
    mean_where_defined,
    other_scores,
    score,
    summarise,
)

__all__ = [
    "CLIP_METRICS",
    "METRICS",
    "OTHER_METRICS",
    "ClipScores",
    "CountedClip",
    "FrameScores",
    "clip_scores",
    "clip_scores_of",
    "count_clip",
    "mean_where_defined",
    "other_scores",
    "score",
    "summarise",
]
