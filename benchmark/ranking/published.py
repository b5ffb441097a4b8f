"""The figures that the paper prints, to stand beside ours in grey: its data were others, so they rank with nothing.

Its segmentation tables (CLEVR-3D and MultiShapeNet; YCB moving and static), under the names of our tracks and models.
"""

from collections.abc import Mapping

PAPER_TRACKS = {
    "moving": "YCB Moving-Object",
    "static": "YCB Static",
    "clevr3d": "CLEVR-3D",
    "multishape": "MultiShapeNet",
}
"""Our tracks and what the paper has in their place."""

PAPER_MODELS = {
    "obsurf": "ObSuRF",
    "obsurf-no-overlap-depth": "ObSuRF w/o overlap with depth",
    "obsurf-no-overlap": "ObSuRF w/o overlap",
    "slot-attention": "slot att.",
    "ic-sbp": "ic-sbp",
    "obpose-loc": "ObPose loc. only",
    "obpose": "ObPose loc. & rot.",
}
"""Our models and the paper's names for them, in its order."""

_YCB = ("miou_bg", "ari_fg", "msc_fg")
_RAYS = ("ari_fg", "ari")

_TABLES: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "moving": (
        _YCB,
        {
            "obsurf-no-overlap-depth": "0.89±0.09 0.18±0.21 0.21±0.02",
            "obsurf-no-overlap": "0.97±0.02 0.28±0.36 0.28±0.26",
            "slot-attention": "0.98±0.02 0.13±0.05 0.19±0.02",
            "ic-sbp": "0.96±0.05 0.87±0.02 0.90±0.02",
            "obpose-loc": "1.00±0.00 0.96±0.00 0.97±0.00",
            "obpose": "1.00±0.00 0.96±0.00 0.97±0.00",
        },
    ),
    "static": (
        _YCB,
        {
            "obsurf-no-overlap-depth": "0.92±0.04 0.31±0.15 0.37±0.07",
            "obsurf-no-overlap": "0.98±0.00 0.22±0.12 0.36±0.05",
            "slot-attention": "1.00±0.00 0.80±0.01 0.84±0.00",
            "ic-sbp": "0.97±0.03 0.83±0.09 0.80±0.15",
            "obpose-loc": "0.99±0.00 0.89±0.01 0.87±0.03",
            "obpose": "0.98±0.00 0.88±0.01 0.84±0.03",
        },
    ),
    "clevr3d": (
        _RAYS,
        {"obsurf": "0.96 0.95", "obsurf-no-overlap": "0.86 0.06", "slot-attention": "0.46 0.01", "obpose": "0.99 0.84"},
    ),
    "multishape": (
        _RAYS,
        {"obsurf": "0.81 0.64", "obsurf-no-overlap": "0.94 0.16", "slot-attention": "0.52 0.08", "obpose": "0.99 0.81"},
    ),
}


def paper_metrics(track: str) -> tuple[str, ...]:
    """Metrics that the paper prints for the track; none where it has nothing like it."""
    return _TABLES[track][0] if track in _TABLES else ()


def paper_cells(track: str, model: str) -> Mapping[str, str]:
    """Metric to what the paper prints, as mean±std where it gives both; empty where it has nothing."""
    metrics, rows = _TABLES.get(track, ((), {}))
    return dict(zip(metrics, rows[model].split(), strict=True)) if model in rows else {}
