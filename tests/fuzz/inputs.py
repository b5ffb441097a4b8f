"""Damaged files and what commands made of them, as plain values."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Input:
    """A valid file that is to be damaged, and the command that reads it."""

    world: Path
    """Folder of valid files; each input gets a copy of it."""
    file: str
    """In that folder."""
    seed: int
    """Decides what is done to it."""
    command: str
    """With {w} for the copy, and {o} for a path at which nothing is."""
    called: tuple[str, ...] = ()
    """Names of the file in messages, beside its own and that of a folder that it is in."""


@dataclass(frozen=True)
class Ending:
    """How the command ended on an input."""

    file: str
    seed: int
    command: str
    change: str
    """Description of the damage to the file."""
    fault: str
    """Fault in how the command ended; empty if there is none."""
    place: str
    """Kind of the fault, and innermost of our functions, by which faults are told apart."""
    code: int | None
    """Exit code; None where there was none."""
    output: str
    seconds: float
    mib: float
    """Largest resident memory of the process."""

    def told(self) -> str:
        """All that is needed to find the fault."""
        shown = self.output if len(self.output) < 3000 else f"{self.output[:1000]}\n...\n{self.output[-2000:]}"
        return f"{self.fault}\n  {self.command}\n  {self.file}, seed {self.seed}: {self.change}\n{shown}"


def faults_among(endings: Sequence[Ending]) -> str:
    """One example of each fault and how often it came; empty if there is none."""
    found: dict[str, list[Ending]] = {}
    for ending in endings:
        if ending.fault:
            found.setdefault(ending.place, []).append(ending)
    ordered = sorted(found.values(), key=len, reverse=True)
    return "\n\n".join(f"{len(alike)} of {len(endings)} inputs: {alike[0].told()}" for alike in ordered)
