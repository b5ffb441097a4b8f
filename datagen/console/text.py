"""Numbers in messages."""


def counted(number: int | float, noun: str, plural: str | None = None) -> str:
    """A number of things in words, with the noun in its right form."""
    return f"{number if isinstance(number, int) else f'{number:g}'} {noun if number == 1 else plural or noun + 's'}"
