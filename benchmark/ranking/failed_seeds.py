"""Which seeds count as failed: a rule of scores, declared before any run and the same for all models.

A seed failed if its loss became nan, or a headline metric is undefined in all of its frames and yet not in those of
every other run on the dataset; or if its mIoU-BG is under 0.5 (background and objects changed places); or if its MSC-FG
is no more than 0.05 above the best floor of the track (the model collapsed). Floors set that bar and oracles show what
the truth would reach: neither competes, and neither is measured by it. Where no floor was scored there is no bar, which
the tables say. A run that ended without scores failed too, for the reason it gave. Failed seeds are never dropped
silently: tables show every model with and without them.
"""

import math

from benchmark.results.run_folder import RunRow

LEAST_MIOU_BG = 0.5
LEAST_ABOVE_FLOOR = 0.05

CAUSES = ("nan", "swap", "collapse")

HEADLINE = ("ari_fg", "msc_fg", "miou_bg", "ari")
"""Metrics that must be defined."""


def cause_of_failure(miou_bg: float, msc_fg: float, best_floor: float, *, finite: bool = True) -> str:
    """One of `CAUSES`, or nothing where the seed is fine.

    Args:
        miou_bg: of this seed, with the background slot that the model declared.
        msc_fg: of this seed.
        best_floor: largest MSC-FG of a floor on the same track; nan where no floor was run, and then no collapse is
            seen.
        finite: whether the loss stayed finite while training, and the headline metrics are defined.
    """
    if not finite:
        return "nan"
    if miou_bg < LEAST_MIOU_BG:
        return "swap"
    return "collapse" if msc_fg <= best_floor + LEAST_ABOVE_FLOOR else ""


def has_finite_loss(row: RunRow) -> bool:
    """Whether no loss in the learning curve is nan or infinite; models that learn nothing have none."""
    points = row.learning_curve or []
    return all(math.isfinite(value) for point in points for name, value in point.items() if "loss" in name)
