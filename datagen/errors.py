"""What can go wrong in a way the user can mend, and the exit code that says so."""

EXIT_OK = 0
EXIT_USAGE = 2
EXIT_INCOMPLETE = 3
EXIT_VERIFICATION = 4
EXIT_INTERRUPTED = 130


class DatagenError(Exception):
    """A failure with one clear message for the user: what was wrong, what was expected, what to do."""

    exit_code = EXIT_INCOMPLETE


class UsageError(DatagenError):
    """The request itself is wrong: an unknown name, settings that contradict each other, a foreign file."""

    exit_code = EXIT_USAGE


class ImpossibleScene(UsageError):
    """No scene that satisfies the recipe was found within the allowed number of attempts."""


class CorruptFile(DatagenError):
    """A file that is truncated, damaged or not of our format."""


class VerificationFailed(DatagenError):
    """The dataset's content contradicts itself."""

    exit_code = EXIT_VERIFICATION
