"""Facts about the machine, the process and the code that runs."""

import os
import resource
import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent


def peak_mib() -> float:
    """Largest resident memory of this process so far, MiB.

    On Linux this is VmHWM, since a child process inherits its parent's ru_maxrss.
    """
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def resident_mib(process: int) -> float:
    """Memory that a process holds now, MiB; 0 if the system does not provide it."""
    with suppress(OSError, IndexError, ValueError):
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return 0.0


def machine_mib() -> float:
    """Memory of this machine, MiB."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**20


def cores() -> int:
    """Cores that this process may use."""
    from joblib import cpu_count  # slow import, not needed for --help

    return cpu_count()


@cache
def commit() -> str:
    """Commit of the code, with a plus sign if files differ from it; empty outside a git checkout."""
    if not (ROOT / ".git").exists():
        return ""
    with suppress(OSError):
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", "benchmark", "datagen", "obpose")
        return _git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    return ""


def _git(*arguments: str) -> str:
    found = subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True, check=False)
    return found.stdout.strip() if found.returncode == 0 else ""
