import pytest
import torch
from torch import Tensor

from obpose.model.nerf.detail import EDGE
from obpose.scenes.priors.flow import (
    PLAIN,
    PLAIN_WEIGHT,
    SHAPES,
    VALUES,
    Components,
    Flow,
    describe,
    flow_loss,
    mirrored,
    sample_grids,
)
from obpose.scenes.priors.grids import COLOUR_LIMIT, DENSITY_LIMIT, Grids, mean_colour


def some_grids(count: int = 3, seed: int = 0) -> Grids:
    generator = torch.Generator().manual_seed(seed)
    values = 2 * torch.randn(count, EDGE, EDGE, EDGE, 4, generator=generator).clamp(-1.9, 1.9)
    return Grids(values, 0.02 + 0.06 * torch.rand(count, generator=generator))


def some_flow() -> Flow:
    torch.manual_seed(0)
    flow = Flow(latent=5)
    describe(flow, some_grids(20), torch.randn(20, 5))
    return flow.eval()


class Sure(Flow):
    """Knows one object alone, and takes whatever it sees for that."""

    def __init__(self, only: Tensor, *, wrong: float = 0.0) -> None:
        super().__init__(latent=5)
        self.load_state_dict(some_flow().state_dict())
        self.only, self.wrong = only, wrong

    def forward(self, noisy: Tensor, time: Tensor) -> Tensor:
        return self.only.expand_as(noisy) + self.wrong


def test_decoding_is_the_inverse_of_encoding():
    flow, grids = some_flow(), some_grids(20)
    again = flow.decode(flow.encode(grids))
    torch.testing.assert_close(again.values, grids.values, atol=1e-4, rtol=0)
    torch.testing.assert_close(again.half, grids.half)


def test_mean_colour_and_size_are_told_from_those_of_all_and_nothing_else_tells_them():
    flow, grids = some_flow(), some_grids(20)
    plain = flow.encode(grids)[:, -PLAIN:]
    torch.testing.assert_close(plain.mean(dim=0), torch.zeros(PLAIN), atol=1e-5, rtol=0)
    torch.testing.assert_close(plain.std(dim=0), torch.ones(PLAIN))
    other = Grids(grids.values + torch.tensor([0, 0.5, -0.5, 0.2]), 2 * grids.half)
    torch.testing.assert_close(flow.encode(other)[:, :-PLAIN], flow.encode(grids)[:, :-PLAIN], atol=1e-4, rtol=0)
    assert (flow.encode(other)[:, -PLAIN:] != plain).all()


def test_shapes_are_told_apart_from_colours():
    flow, grids = some_flow(), some_grids(2)
    other = Grids(grids.values.clone(), grids.half)
    other.values[..., 1:] = -other.values[..., 1:]
    torch.testing.assert_close(flow.encode(other)[:, :SHAPES], flow.encode(grids)[:, :SHAPES])
    assert not torch.allclose(flow.encode(other)[:, SHAPES:], flow.encode(grids)[:, SHAPES:])


def test_a_mean_colour_is_that_of_what_is_dense():
    density = torch.tensor([-50.0, 50.0, 50.0]).view(1, 3, 1)
    colour = torch.tensor([[9.0, 9.0, 9.0], [1.0, 0.0, -1.0], [3.0, 0.0, 0.0]])[None]
    torch.testing.assert_close(mean_colour(density, colour), torch.tensor([[2.0, 0.0, -0.5]]))


def test_what_is_decoded_is_within_the_limits_of_logits():
    values = some_flow().decode(99 * torch.randn(1, VALUES)).values
    assert values[..., 0].abs().max() == DENSITY_LIMIT
    assert values[..., 1:].abs().max() == COLOUR_LIMIT


def test_a_flow_that_knows_one_object_samples_it():
    only = some_grids(20).take(torch.tensor([3]))
    drawn = sample_grids(Sure(some_flow().encode(only)), 4, torch.Generator().manual_seed(0))
    torch.testing.assert_close(drawn.values, only.values.expand(4, -1, -1, -1, -1), atol=1e-3, rtol=0)
    torch.testing.assert_close(drawn.half, only.half.expand(4), atol=1e-5, rtol=0)


def test_the_loss_is_zero_where_the_object_is_known_and_else_the_squared_error_over_that_of_the_noise():
    only = torch.randn(1, VALUES)
    assert flow_loss(Sure(only), only, torch.Generator().manual_seed(0)) == 0
    wrong = flow_loss(Sure(only, wrong=0.1), only, torch.Generator().manual_seed(0))
    time = torch.sigmoid(torch.randn(1, generator=torch.Generator().manual_seed(0)) - 0.4)
    expected = 0.01 * (VALUES - PLAIN + PLAIN * PLAIN_WEIGHT) / VALUES / (1 - time) ** 2
    torch.testing.assert_close(wrong, expected[0])


def test_the_time_and_every_number_matter():
    flow = some_flow()
    with torch.no_grad():
        for layer in flow.layers:
            layer.modulation.weight.normal_(std=0.1)
    noisy, time = torch.randn(1, VALUES), torch.tensor([0.3])
    before = flow(noisy, time)
    assert not torch.allclose(flow(noisy, time + 0.3), before)
    changed = flow(noisy + torch.eye(VALUES), time.expand(VALUES))
    assert (changed - before).abs().amin() > 0


def test_only_in_training_some_is_left_out():
    flow, noisy, time = some_flow(), torch.randn(1, VALUES), torch.tensor([0.3])
    assert torch.equal(flow(noisy, time), flow(noisy, time))
    flow.train()
    assert not torch.equal(flow(noisy, time), flow(noisy, time))


def test_mirrored_exchanges_left_and_right_alone():
    values = torch.zeros(1, EDGE, EDGE, EDGE, 4)
    values[0, 3, 5, 7] = 1  # towards the camera, to its right, up
    found = mirrored(Grids(values, torch.ones(1)))
    assert found.values[..., 0].nonzero().tolist() == [[0, 3, EDGE - 1 - 5, 7]]
    assert found.half == 1


class Gaussian(Flow):
    """Objects whose numbers are normally distributed, with a standard deviation of 2; the flow doubles the noise."""

    def forward(self, noisy: Tensor, time: Tensor) -> Tensor:
        share = time[:, None]
        return noisy * share * 4 / (4 * share**2 + (1 - share) ** 2)


def test_sampling_follows_the_flow_to_the_second_order():
    noise = torch.randn(3, VALUES, generator=torch.Generator().manual_seed(0))
    drawn = sample_grids(Gaussian(latent=5), 3, torch.Generator().manual_seed(0))
    # By Euler's method it would be 1.93 times as much.
    torch.testing.assert_close(drawn.half.log(), 2 * noise[:, -1], rtol=2e-3, atol=0)


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
