from typing import get_args

import numpy as np

from obpose.random_streams import Stream, training_rng, training_seed

STREAMS: tuple[Stream, ...] = get_args(Stream)


def test_numbers_are_those_of_published_weights():
    for number, stream in enumerate(("epoch", "window", "pasted image", "choice of images")):
        assert training_rng(5, stream, 7, 11).random() == np.random.default_rng([5, number, 7, 11]).random()
    assert training_seed(5, "noise", 7, 11) == np.random.SeedSequence([5, 2, 7, 11]).generate_state(1)[0]


def test_streams_and_places_differ_within_a_kind_of_generator():
    drawn = {training_rng(0, stream, *place).random() for stream in STREAMS for place in ((0, 0), (0, 1), (1, 0))}
    assert len(drawn) == 3 * (len(STREAMS) - 1)  # noise is drawn by PyTorch
