"""The reasons for which a sampled scene is rejected and drawn again."""


class Rejected(Exception):
    """A sample that breaks the rule called `reason`; `fitting` counts objects with a place in view if all need one."""

    def __init__(self, reason: str, *, fitting: int | None = None):
        super().__init__(reason)
        self.reason = reason
        self.fitting = fitting
