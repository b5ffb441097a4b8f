"""What is wrong with a dataset, in one line."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One contradiction; what it is about is left None where it concerns more than one."""

    check: str
    """Name of the check that failed, see `docs/dataset.md`."""
    message: str
    """What is wrong, with the figure and what was allowed."""
    split: str | None = None
    shard: str | None = None
    scene: int | None = None
    frame: int | None = None
    view: int | None = None

    def __str__(self) -> str:
        """Place, check and figure."""
        places = ("split", "shard", "scene", "frame", "view")
        where = " ".join(f"{name} {getattr(self, name)}" for name in places if getattr(self, name) is not None)
        return f"{where or 'dataset'}: {self.check}: {self.message}"
