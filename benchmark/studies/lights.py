"""How far is the light estimated from frames from the one that the generator rendered them with?"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from jaxtyping import Float

from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import ModelFlags, TableFlags, first_clips, markdown
from obpose.scenes.appearance.light import strength
from obpose.scenes.infer import infer_scene
from obpose.scenes.refine import STEPS


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""


def run(flags: Flags) -> list[Line]:
    """Estimate the light of each scene, and print a summary."""
    flags.check(scenes=1)
    origin, folder = flags.origin(), flags.folder()
    lines: list[Line] = []
    for index, (record, observation) in enumerate(first_clips(folder, flags.split, flags.scenes)):
        light = infer_scene(origin, observation, refinements=STEPS).appearance.light
        # The first light of a scene casts the shadows.
        degrees = angle(light[:3].numpy(), record["lights/direction"][0]) if strength(light) else nan
        lines.append({"scene": index, "strength": strength(light), "degrees": degrees})
    print(markdown([summary(lines)]) + "\n")
    return lines


def angle(one: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> float:
    """Angle between two unit vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def summary(lines: Sequence[Line]) -> Line:
    """Summarise the scenes; a light without strength was not found."""
    found = [line for line in lines if line["strength"]]
    counts = {"scenes": len(lines), "lights found": len(found)}
    if not found:
        return counts
    middle, most, largest = np.quantile([float(line["degrees"]) for line in found], [0.5, 0.9, 1.0]).tolist()
    mean = float(np.mean([float(line["strength"]) for line in found]))
    return {**counts, "degrees, median": middle, "90 % below": most, "largest": largest, "strength, mean": mean}
