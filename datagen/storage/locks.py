"""Folder locks without lock files; the system releases the lock of a killed process."""

import fcntl
import os
from pathlib import Path


class FolderLock:
    """An advisory lock (`flock`) on the folder's own descriptor; `close` releases it.

    File systems without such locks grant every request; `is_real` says whether the last one was a real lock.

    Raises:
        OSError: the folder is not there, or may not be opened.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.is_real = False
        self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)

    def close(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)

    def take_alone(self) -> bool:
        """Try to hold the folder alone; on failure, a lock held before is lost."""
        return self._take(fcntl.LOCK_EX)

    def take_shared(self) -> bool:
        """Try to hold the folder beside others that share it; on failure, a lock held before is lost."""
        return self._take(fcntl.LOCK_SH)

    def is_current(self) -> bool:
        """Whether the folder's path still leads to the folder that was opened."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self.folder))
        except (FileNotFoundError, NotADirectoryError):
            return False

    def _take(self, kind: int) -> bool:
        try:
            fcntl.flock(self._descriptor, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            self.is_real = False
            return False
        except OSError:  # some file systems of networks have no locks
            self.is_real = False
            return True
        self.is_real = True
        return True
