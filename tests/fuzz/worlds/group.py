"""Valid files that are built together, and which commands read each of them."""

import shutil
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.commands import run_command
from tests.fuzz.inputs import Input

MODEL = "obpose--moving--64x64"
DATASET = "--recipe noisy --frames 2 --resolution 16x16 --seed 3 --edits remove,move,add --workers 1"
MOVING = "--recipe moving --frames 2 --resolution 16x16 --workers 1"
TINY = " ".join(f"--set {change}" for change in ("train.batch=1", "train.rays=16", "train.warmup=1", "model.voxels=4"))


@dataclass(frozen=True)
class Target:
    """A file, and commands that read it."""

    file: str
    """In the world; with a `*` where its name has a hash in it."""
    commands: Sequence[str]
    share: int = 1
    """Share of the group's inputs."""
    called: tuple[str, ...] = ()
    """Names of the file in messages, beside its own and that of a folder that it is in."""


@dataclass(frozen=True)
class Group:
    """Files that are built together."""

    build: Callable[[Path], None]
    targets: Sequence[Target]
    is_sound: bool = True
    """Whether all commands succeed on the valid files."""


def inputs_of(group: Group, world: Path, count: int) -> list[Input]:
    """About so many inputs, of all targets by their shares; each target has its commands in turn."""
    total = sum(target.share for target in group.targets)
    found = []
    for target in group.targets:
        (file,) = world.glob(target.file)
        first_seed = zlib.crc32(target.file.encode())
        for number in range(max(1, round(count * target.share / total))):
            command = target.commands[number % len(target.commands)]
            found.append(Input(world, str(file.relative_to(world)), first_seed + number, command, target.called))
    return found


def run_undamaged(group: Group, world: Path, scratch: Path) -> None:
    """Run every command once on the valid files, where it succeeds in sound groups; its imports stay.

    Raises:
        RuntimeError: a command does not succeed.
    """
    commands = dict.fromkeys(command for target in group.targets for command in target.commands)
    for command in commands if group.is_sound else ():
        shutil.copytree(world, scratch)
        run(command.format(w=scratch, o=scratch / "new"))
        shutil.rmtree(scratch)


def run(command: str) -> None:
    """Run a command that has to succeed.

    Raises:
        RuntimeError: it does not.
    """
    code, trace = run_command(command.split(" "))
    if code != 0:
        raise RuntimeError(f"{command} ended with {code}: {trace}")
