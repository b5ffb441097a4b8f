"""Rule for failed seeds, fixed before any run and the same for all models.

A seed failed for one of these causes:
- nan: its loss became nan or infinite.
- swap: its mIoU-BG is below 0.5, so background and objects changed places.
- collapse: its MSC-FG is at most 0.05 above the best floor of the track. Without a floor, collapse is not detected, and
  the tables say so.
- It ended without scores, for the reason that its row gives.

The rule does not apply to floors and oracles. Tables show every model with and without its failed seeds.
"""

import math

from benchmark.results.run_folder import RunRow

LEAST_MIOU_BG = 0.5
LEAST_ABOVE_FLOOR = 0.05


def cause_of_failure(miou_bg: float, msc_fg: float, best_floor: float, *, finite: bool = True) -> str:
    """Determine the cause of failure, `nan`, `swap` or `collapse`; empty if the seed did not fail.

    `best_floor` is the largest MSC-FG of a floor on the same track, nan if no floor was run. `finite` tells whether the
    loss stayed finite in training.
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
