import pytest
import torch

from obpose.scenes.priors.components import Components


def flat(count: int = 50, seed: int = 0) -> torch.Tensor:
    """Vectors of ten numbers that differ in three ways, in one of them most."""
    generator = torch.Generator().manual_seed(seed)
    ways = torch.linalg.qr(torch.randn(10, 3, generator=generator)).Q
    return 5 + torch.randn(count, 3, generator=generator) * torch.tensor([4.0, 2.0, 1.0]) @ ways.T


def fitted(vectors: torch.Tensor, count: int) -> Components:
    components = Components(vectors.shape[1], count)
    components.fit(vectors)
    return components


def test_nothing_is_lost_of_vectors_that_differ_in_as_many_ways():
    vectors = flat()
    components = fitted(vectors, 3)
    torch.testing.assert_close(components.decode(components.encode(vectors)), vectors)


def test_fewer_numbers_keep_what_differs_most():
    vectors = flat()
    components = fitted(vectors, 2)
    _, lengths, _ = torch.linalg.svd(vectors - vectors.mean(dim=0))
    lost = (components.decode(components.encode(vectors)) - vectors).square().sum()
    torch.testing.assert_close(lost, lengths[2] ** 2)


def test_numbers_have_one_scale_and_keep_their_weights():
    vectors = flat(5000)
    numbers = fitted(vectors, 3).encode(vectors)
    assert numbers.square().mean() == pytest.approx(1, abs=1e-4)
    spread = numbers.std(dim=0)
    assert (spread[0] / spread[1]).item() == pytest.approx(2, rel=0.1)
    assert (spread[1] / spread[2]).item() == pytest.approx(2, rel=0.1)


def test_axes_that_are_not_needed_say_nothing():
    vectors = flat()
    components = fitted(vectors, 6)
    torch.testing.assert_close(components.decode(components.encode(vectors)), vectors)
    assert (components.axes.norm(dim=0) > 0).tolist() == 3 * [True] + 3 * [False]
    few = fitted(vectors[:2], 6)
    torch.testing.assert_close(few.decode(few.encode(vectors[:2])), vectors[:2])
    alike = fitted(vectors[:1].repeat(4, 1), 6)
    torch.testing.assert_close(alike.decode(torch.ones(1, 6)), vectors[:1])


def test_the_same_vectors_give_the_same_axes_whatever_was_drawn_before():
    torch.manual_seed(1)
    one = fitted(flat(), 2)
    torch.manual_seed(2)
    before = torch.random.get_rng_state()
    assert torch.equal(fitted(flat(), 2).axes, one.axes)
    assert torch.equal(torch.random.get_rng_state(), before)
