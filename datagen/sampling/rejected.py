"""The reasons for which a sampled scene is thrown away and drawn anew."""


class Rejected(Exception):
    """A sample that breaks a rule of its recipe; carries the rule's short name."""

    def __init__(self, reason: str):
        super().__init__(reason)
        self.reason = reason
