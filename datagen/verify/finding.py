"""One-line descriptions of what is wrong with a dataset."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One contradiction in a dataset; a place, such as `scene`, is None if the finding is not specific to one."""

    check: str
    """Name of the check that failed, see `docs/dataset.md`."""
    message: str
    """Description of the error, with the measured and the allowed value."""
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
