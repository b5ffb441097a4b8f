"""Process that cuts one mesh with CoACD: `python -m datagen.meshes.coacd_process MESH HULLS SECONDS PARENT`."""

import os
import resource
import shutil
import sys
from pathlib import Path

import numpy as np

from datagen.console import interrupts
from datagen.meshes.hulls import MOST_CORNERS, OPTIONS
from datagen.storage.safe_io import read_npz


def main(source: str, target: str, seconds: str, parent: str) -> None:
    """Read vertices and faces, cut them, and write the corners of all hulls; the system kills it after the CPU time.

    If the process of the number `parent` dies, this one deletes the folder of the two files and exits.
    """
    interrupts.end_with(int(parent), lambda: _delete(Path(target).parent))
    # The hard limit is higher, because reaching it would raise another signal.
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
    try:
        import coacd

        coacd.set_log_level("error")
        mesh = read_npz(Path(source), ("vertices", "faces"))
        parts = coacd.run_coacd(
            coacd.Mesh(mesh["vertices"], mesh["faces"]), seed=0, decimate=True, max_ch_vertex=MOST_CORNERS, **OPTIONS
        )
        corners = [np.asarray(vertices, np.float64) for vertices, _ in parts]
        np.savez(target, corners=np.concatenate(corners), counts=np.array([len(part) for part in corners]))
    finally:
        # The parent may have died since the thread that watches it looked last, or while that thread deletes files that
        # are needed here.
        if os.getppid() != int(parent):
            _delete(Path(target).parent)


def _delete(folder: Path) -> None:
    """Delete a folder; again if the other thread wrote into it meanwhile."""
    for _ in range(10):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return


if __name__ == "__main__":
    main(*sys.argv[1:])
