"""Valid files of every kind that the commands read, as small as can be."""

from tests.fuzz.worlds.benchmarks import BENCHMARKS
from tests.fuzz.worlds.datasets import DATASETS
from tests.fuzz.worlds.frames import FRAMES
from tests.fuzz.worlds.models import MODELS
from tests.fuzz.worlds.quick import MISBEHAVING
from tests.fuzz.worlds.sources import SOURCES

GROUPS = {
    "datasets": DATASETS,
    "models": MODELS,
    "frames": FRAMES,
    "benchmarks": BENCHMARKS,
    "sources": SOURCES,
    "misbehaving": MISBEHAVING,
}
