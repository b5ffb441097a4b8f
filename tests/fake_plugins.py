"""A package of somebody else, with models for the benchmark, as pip would leave it in a folder of the path."""

from pathlib import Path

MODELS = '''
import os
import signal
import subprocess
import sys
import time

import numpy as np

from benchmark.models.interface import Prediction
from datagen.errors import Busy


class Good:
    """Everything above the table's depth is one object."""

    version = 3
    random = False

    def fit(self, train, val, *, seed, budget):
        self.clips = len(train), len(val)
        assert all(clip.truth is None for clip in val)

    def segment(self, clip):
        print("models may print")
        return Prediction((clip.rgb[..., 0] > 25).astype(np.int64), 0)


class Chance(Good):
    random = True
    learning_curve = [{"step": 1, "loss": np.float32(0.5)}]
    parameters = np.int64(7)

    def __init__(self, slots, steps=1):
        self.slots, self.steps = slots, steps

    def fit(self, train, val, *, seed, budget):
        assert len(train) and len(val)
        self.seed = seed

    def segment(self, clip):
        rng = np.random.default_rng([self.seed, self.steps])
        return Prediction(rng.integers(self.slots, size=clip.depth.shape), None)


class Slow(Chance):
    def segment(self, clip):
        time.sleep(0.1)
        return super().segment(clip)


class Raises(Good):
    def segment(self, clip):
        raise ValueError("no idea")


class RaisesInFit(Good):
    def fit(self, train, val, *, seed, budget):
        raise OSError("no weights")


class Taken(Good):
    """Learns in a folder that another process learns in."""

    def fit(self, train, val, *, seed, budget):
        raise Busy("Another process is writing to there; let it end.")


class Crashes(Good):
    def segment(self, clip):
        os.kill(os.getpid(), signal.SIGSEGV)


class Killed(Good):
    def segment(self, clip):
        os.kill(os.getpid(), signal.SIGKILL)


class Leaves(Good):
    def segment(self, clip):
        os._exit(0)


class Exits(Good):
    def fit(self, train, val, *, seed, budget):
        sys.exit(0)


class ExitsWithACode(Good):
    def segment(self, clip):
        os._exit(7)


class Hangs(Good):
    """Waits, and has started another process that waits."""

    def segment(self, clip):
        subprocess.run(["sleep", "1000"])


class Hoards(Good):
    def segment(self, clip):
        self.hoard = [np.ones(2**24) for _ in range(100)]


class OutOfMemory(Good):
    def segment(self, clip):
        raise MemoryError("cannot allocate")


class WrongShape(Good):
    def segment(self, clip):
        return Prediction(np.zeros(clip.depth.shape[1:], np.int64), 0)


class Nan(Good):
    def segment(self, clip):
        return Prediction(np.full(clip.depth.shape, np.nan), 0)


class TooManySlots(Good):
    def segment(self, clip):
        return Prediction(np.full(clip.depth.shape, 256), 0)


class FailsOnSecondTrack(Good):
    def fit(self, train, val, *, seed, budget):
        self.seen = set()

    def segment(self, clip):
        self.seen.add(clip.depth.shape)
        if len(self.seen) == 2:
            raise ValueError("another size")
        return super().segment(clip)
'''

CLASSES = {
    "good": "Good",
    "chance": "Chance",
    "slow": "Slow",
    "raises": "Raises",
    "raises-in-fit": "RaisesInFit",
    "taken": "Taken",
    "crashes": "Crashes",
    "killed": "Killed",
    "leaves": "Leaves",
    "exits": "Exits",
    "exits-with-a-code": "ExitsWithACode",
    "hangs": "Hangs",
    "hoards": "Hoards",
    "out-of-memory": "OutOfMemory",
    "wrong-shape": "WrongShape",
    "nan": "Nan",
    "too-many-slots": "TooManySlots",
    "fails-on-second-track": "FailsOnSecondTrack",
}


def install(folder: Path) -> Path:
    """Write the package; the folder is then to be put on the path."""
    info = folder / "foreign_models-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "foreign_models.py").write_text(MODELS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-models\nVersion: 1.0\n")
    entries = [f"{name} = foreign_models:{kind}" for name, kind in CLASSES.items()]
    (info / "entry_points.txt").write_text("\n".join(["[obpose.models]", *entries, ""]))
    return folder
