"""Errors that users can fix, and the exit codes of all commands."""

from datagen.errors import EXIT_INCOMPLETE as EXIT_INCOMPLETE
from datagen.errors import EXIT_INTERRUPTED as EXIT_INTERRUPTED
from datagen.errors import EXIT_OK as EXIT_OK
from datagen.errors import Busy as Busy
from datagen.errors import CorruptFile as CorruptFile
from datagen.errors import DatagenError as DatagenError
from datagen.errors import NoTable as NoTable
from datagen.errors import UsageError as UsageError
from datagen.errors import is_out_of_memory as is_out_of_memory
from datagen.errors import unknown_name as unknown_name


class Diverged(DatagenError):
    """Training produced numbers that are not finite."""


class Interrupted(DatagenError):
    """Somebody asked the training to stop; it can go on later."""

    exit_code = EXIT_INTERRUPTED
