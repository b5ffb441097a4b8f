import pytest
import torch
from torch import Tensor

from obpose.creation.flow import SIZE_WEIGHT, TOKENS, VALUES, Flow, describe, flow_loss, mirrored, sample_grids
from obpose.creation.grids import COLOUR_LIMIT, DENSITY_LIMIT, Grids
from obpose.nerf.detail import EDGE


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

    def __init__(self, grids: Grids, *, wrong: float = 0.0) -> None:
        super().__init__(latent=5)
        self.patches, self.size = self.encode(grids)
        self.wrong = wrong

    def forward(self, patches: Tensor, size: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
        return self.patches.expand_as(patches) + self.wrong, self.size.expand_as(size) + self.wrong


def test_decoding_is_the_inverse_of_encoding():
    flow, grids = some_flow(), some_grids()
    again = flow.decode(*flow.encode(grids))
    torch.testing.assert_close(again.values, grids.values)
    torch.testing.assert_close(again.half, grids.half)


def test_a_patch_is_a_block_of_neighbours():
    flow, grids = some_flow(), some_grids(1)
    patches, _ = flow.encode(grids)
    grids.values[0, 8:16, 0:4, 8:12] += 1
    changed = (flow.encode(grids)[0] != patches).any(dim=-1)[0]
    # Patches are counted x, y, z, two and twice four of them.
    assert changed.nonzero()[:, 0].tolist() == [1 * 16 + 0 * 4 + 2]


def test_what_is_decoded_is_within_the_limits_of_logits():
    flow = some_flow()
    grids = flow.decode(9 * torch.ones(1, TOKENS, VALUES), torch.zeros(1))
    assert grids.values[0, 0, 0, 0].tolist() == [DENSITY_LIMIT] + 3 * [COLOUR_LIMIT]


def test_sizes_are_told_from_those_of_all():
    flow, grids = some_flow(), some_grids(20)
    _, size = flow.encode(grids)
    assert float(size.mean()) == pytest.approx(0, abs=1e-5)
    assert float(size.std()) == pytest.approx(1, abs=1e-5)


def test_a_flow_that_knows_one_object_samples_it():
    only = some_grids(1)
    drawn = sample_grids(Sure(only), 4, torch.Generator().manual_seed(0))
    torch.testing.assert_close(drawn.values, only.values.expand(4, -1, -1, -1, -1), atol=1e-4, rtol=0)
    torch.testing.assert_close(drawn.half, only.half.expand(4), atol=1e-5, rtol=0)


def test_the_loss_is_zero_where_the_object_is_known_and_else_the_squared_error_over_that_of_the_noise():
    only = some_grids(1)
    assert flow_loss(Sure(only), only, torch.Generator().manual_seed(0)) == 0
    wrong = flow_loss(Sure(only, wrong=0.1), only, torch.Generator().manual_seed(0))
    time = torch.sigmoid(torch.randn(1, generator=torch.Generator().manual_seed(0)) * 0.9 - 0.6)
    expected = 0.01 * (1 + SIZE_WEIGHT) / (1 - time) ** 2
    torch.testing.assert_close(wrong, expected[0])


def test_samples_follow_from_the_seed():
    flow = some_flow()
    one, again, other = (sample_grids(flow, 2, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1))
    assert torch.equal(one.values, again.values)
    assert not torch.equal(one.values, other.values)
    assert not torch.equal(one.values[0], one.values[1])
    assert len(sample_grids(flow, 0, torch.Generator()).half) == 0


def test_the_time_and_every_patch_and_the_size_matter():
    flow = some_flow()
    with torch.no_grad():
        flow.modulation.weight.normal_(std=0.1)
    patches, size, time = torch.randn(1, TOKENS, VALUES), torch.randn(1), torch.tensor([0.3])
    before = flow(patches, size, time)[0]
    assert not torch.allclose(flow(patches, size, time + 0.3)[0], before)
    assert not torch.allclose(flow(patches, size + 1, time)[0], before)
    patches[0, -1] += 1
    assert (flow(patches, size, time)[0] - before).abs().amax(dim=-1).min() > 0


def test_mirrored_exchanges_left_and_right_alone():
    grids = some_grids(2)
    half = mirrored(grids, torch.tensor([0.0, 1.0]))
    assert torch.equal(half.values[0], grids.values[0])
    assert torch.equal(half.values[1], grids.values[1].flip(1))
    assert torch.equal(half.half, grids.half)
