"""A small group for quick tests."""

from pathlib import Path

from tests.fuzz.worlds.group import Group, Target


def build_text(world: Path) -> None:
    """One file, which nobody reads."""
    world.mkdir()
    (world / "victim.json").write_text("{}")


MISBEHAVIOUR = (
    "raise", "allocate", "sleep", "kill", "leave", "exit", "silent", "internal", "unnamed", "long", "warn", "well",
)  # fmt: skip
MISBEHAVING = Group(
    build_text,
    [Target("victim.json", [f"misbehave {what} {{w}}/victim.json"]) for what in MISBEHAVIOUR],
    is_sound=False,
)
