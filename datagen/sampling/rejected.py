"""The reasons for which a sampled scene is rejected and drawn again."""


class Rejected(Exception):
    """A sample that breaks a rule of its recipe.

    Args:
        reason: Short name of the rule.
        fitting: Number of objects that had a place in view, where the rule is that all have one.
    """

    def __init__(self, reason: str, *, fitting: int | None = None):
        super().__init__(reason)
        self.reason = reason
        self.fitting = fitting
