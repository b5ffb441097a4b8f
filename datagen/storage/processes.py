"""Other processes of this machine."""

import os


def is_running(process: int) -> bool:
    """Whether a process of this number is there, whoever it belongs to; no process has a number too large for one."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
