"""The command `python -m benchmark.studies NAME [flags]`: run one of the experiments behind docs/results."""

import sys
from collections.abc import Sequence
from importlib import import_module

import tyro

from benchmark.csv_files import to_csv
from datagen.console.command_line import run_program
from datagen.console.interrupts import interruptible_imports
from datagen.errors import EXIT_OK, UsageError, unknown_name
from datagen.storage.atomic import write_atomically

PROGRAM = "python -m benchmark.studies"
STUDIES = {
    "fitted_scenes": "Draw scenes as inferred, fitted to their frames, and edited",
    "mesh_extents": "Compare the extents of meshes of inferred objects with the true ones",
    "real_frames": "List the scores of each frame of runs on the track real-table",
    "samples": "Compare sampled scenes with real ones, in numbers and in a picture",
    "views": "Compare rendered pictures with the input view and with other views",
}
"""Modules of this package, each with one line of help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a study and return its exit code."""
    return run_program(PROGRAM, lambda: _run(list(sys.argv[1:] if arguments is None else arguments)))


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: {PROGRAM} NAME [flags]\n\nRun one of the experiments behind docs/results. Studies:\n")
        for name, about in STUDIES.items():
            print(f"  {name:<14} {about}")
        print(f"\nOptions of a study: {PROGRAM} NAME --help")
        return EXIT_OK
    name, *rest = arguments
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES)
    with interruptible_imports(PROGRAM):
        from benchmark.studies.inputs import TableFlags, markdown

        study = import_module(f"benchmark.studies.{name}")
    flags = tyro.cli(study.Flags, prog=f"{PROGRAM} {name}", args=rest, description=study.__doc__)
    if not isinstance(flags, TableFlags):
        study.run(flags)
        return EXIT_OK
    if flags.csv is not None and flags.csv.suffix != ".csv":
        raise UsageError(f"--csv {flags.csv}: expected a name that ends with .csv.")
    lines = list(study.run(flags))
    if lines:
        print(markdown(lines))
    if flags.csv is not None:
        write_atomically(flags.csv, to_csv([{**flags.columns, **line} for line in lines]).encode())
    return EXIT_OK


if __name__ == "__main__":
    raise SystemExit(main())
