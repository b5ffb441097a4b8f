import pytest

from datagen.console.text import counted


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, "scene"), "0 scenes"),
        ((1, "scene"), "1 scene"),
        ((2, "scene"), "2 scenes"),
        ((1.0, "minute"), "1 minute"),
        ((0.5, "minute"), "0.5 minutes"),
        ((1234567, "step"), "1234567 steps"),
        ((1, "copy", "copies"), "1 copy"),
        ((3, "copy", "copies"), "3 copies"),
    ],
)
def test_nouns_follow_their_numbers(arguments: tuple, words: str):
    assert counted(*arguments) == words
