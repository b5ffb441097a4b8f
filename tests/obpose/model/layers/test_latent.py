import dataclasses
import math

import pytest
import torch
from torch.nn import GRUCell
from torch.nn.functional import layer_norm, softplus

from obpose.config import LatentConfig
from obpose.model.layers.latent import PRIOR_STD, RecurrentLatent, Start, draw_gaussian, mean_and_std
from obpose.types import Latent

ENCODING, LATENT, HIDDEN = 6, 4, 5
WEIGHTS = ("weight", "bias")
FIELDS = [field.name for field in dataclasses.fields(Latent)]


def module(start: Start = "zero") -> RecurrentLatent:
    torch.manual_seed(0)
    latent = RecurrentLatent(ENCODING, LatentConfig(), start=start, latent=LATENT, hidden=HIDDEN)
    for parameter in latent.parameters():
        torch.nn.init.uniform_(parameter, -0.6, 0.6)
    return latent


def encodings(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, ENCODING, generator=torch.Generator().manual_seed(1))


def unrolled(latent: RecurrentLatent, sequence: torch.Tensor) -> dict[str, torch.Tensor]:
    """Step by step with cells, for one sequence "frame encoding"; latents at their mean."""
    weights = latent.state_dict()
    cells = {name: GRUCell(size, HIDDEN) for name, size in (("posterior", ENCODING), ("prior", LATENT))}
    for name, cell in cells.items():
        cell.load_state_dict({key: weights[f"_{name}.{key}_l0"] for key in cell.state_dict()})
    start = weights.get("_starts", torch.zeros(2, HIDDEN))
    hidden = dict(zip(cells, start[:, None], strict=True))
    steps = []
    for time, encoding in enumerate(sequence):
        hidden["posterior"] = cells["posterior"](encoding[None], hidden["posterior"])
        state = layer_norm(hidden["posterior"], (HIDDEN,), *(weights[f"_posterior_norm.{name}"] for name in WEIGHTS))
        mean, std = numbers(
            latent._posterior_head(torch.cat([state, encoding[None]], dim=-1)), LatentConfig().posterior_std
        )
        if time > 0:
            hidden["prior"] = cells["prior"](steps[-1]["z"], hidden["prior"])
        standard = time == 0 and "_starts" not in weights
        prior = (torch.zeros(1, LATENT), torch.ones(1, LATENT))
        prior_mean, prior_std = prior if standard else numbers(latent._prior_head(hidden["prior"]), PRIOR_STD)
        steps.append({"z": mean, "mean": mean, "std": std, "prior_mean": prior_mean, "prior_std": prior_std})
    return {name: torch.cat([step[name] for step in steps]) for name in FIELDS}


def numbers(parameters: torch.Tensor, typical_std: float) -> tuple[torch.Tensor, torch.Tensor]:
    shift = math.log(math.exp(typical_std) - 1)
    return parameters[:, :LATENT], softplus(parameters[:, LATENT:] + shift) + 1e-4


@pytest.mark.parametrize("start", ["zero", "learned"])
def test_a_clip_equals_cells_unrolled_over_its_frames(start: Start):
    latent, encoding = module(start), encodings(2, 4, 3)
    found = latent(encoding, "mean")
    for batch in range(2):
        for slot in range(3):
            expected = unrolled(latent, encoding[batch, :, slot])
            for name in FIELDS:
                torch.testing.assert_close(getattr(found, name)[batch, :, slot], expected[name])


def test_the_first_prior_is_standard_normal_unless_the_start_is_learned():
    first = module()(encodings(2, 3, 2), "sample", torch.Generator().manual_seed(0))
    assert torch.equal(first.prior_mean[:, 0], torch.zeros(2, 2, LATENT))
    assert torch.equal(first.prior_std[:, 0], torch.ones(2, 2, LATENT))
    assert first.prior_mean[:, 1:].abs().min() > 0
    assert module("learned")(encodings(2, 3, 2), "mean").prior_mean[:, 0].abs().min() > 0


def test_slots_are_sequences_of_their_own_that_share_weights():
    latent, encoding = module(), encodings(2, 3, 4)
    order = torch.tensor([2, 0, 3, 1])
    torch.testing.assert_close(latent(encoding[:, :, order], "mean").z, latent(encoding, "mean").z[:, :, order])


@pytest.mark.parametrize("shape", [(2, 1, 3), (2, 1), (2, 5)])
def test_any_number_of_frames_with_or_without_slots(shape: tuple[int, ...]):
    latent = module("learned")(encodings(*shape), "sample", torch.Generator().manual_seed(0))
    assert all(getattr(latent, name).shape == (*shape, LATENT) for name in FIELDS)


def test_the_mean_repeats_and_samples_follow_the_generator():
    latent, encoding = module(), encodings(1, 3, 2)
    assert torch.equal(latent(encoding, "mean").z, latent(encoding, "mean").z)
    samples = [latent(encoding, "sample", torch.Generator().manual_seed(seed)).z for seed in (0, 0, 1)]
    assert torch.equal(samples[0], samples[1])
    assert not torch.equal(samples[0], samples[2])


def test_priors_and_latents_train_every_weight():
    latent = module("learned")
    found = latent(encodings(2, 3, 2), "sample", torch.Generator().manual_seed(0))
    (found.z.square().sum() + found.prior_mean.square().sum() + found.prior_std.sum()).backward()
    for name, parameter in latent.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_a_prior_teaches_the_latents_that_it_follows_from():
    encoding = encodings(1, 3, 2).requires_grad_()
    module()(encoding, "mean").prior_mean[:, 2].sum().backward()
    assert encoding.grad is not None
    taught = encoding.grad.abs().sum(dim=(0, 2, 3))
    assert (taught > 0).tolist() == [True, True, False]


def test_a_posterior_can_be_wide_read_the_state_alone_and_begin_with_plain_weights():
    config = LatentConfig(posterior_std=0.7, posterior_input="state")
    torch.manual_seed(0)
    latent, plain = (
        RecurrentLatent(ENCODING, config, weights=kind, latent=LATENT, hidden=HIDDEN)
        for kind in ("orthogonal", "uniform")
    )
    assert latent(encodings(2, 3), "mean").std.mean().item() == pytest.approx(0.7, abs=0.15)
    assert latent.get_parameter("_posterior_head.0.weight").shape == (HIDDEN, HIDDEN)
    first, other = (one.get_parameter("_posterior_head.0.weight") for one in (latent, plain))
    torch.testing.assert_close(first @ first.T, torch.eye(HIDDEN))
    assert not torch.allclose(other @ other.T, torch.eye(HIDDEN), atol=0.1)


def test_samples_have_the_mean_and_the_standard_deviation():
    generator = torch.Generator().manual_seed(0)
    mean, std = torch.tensor([-1.0, 0.0, 2.0]), torch.tensor([0.1, 1.0, 0.5])
    z = draw_gaussian(mean.expand(40_000, 3), std.expand(40_000, 3), draw="sample", generator=generator)
    torch.testing.assert_close(z.mean(dim=0), mean, atol=0.02, rtol=0)
    torch.testing.assert_close(z.std(dim=0), std, atol=0.02, rtol=0)


def test_samples_are_differentiable_in_mean_and_standard_deviation():
    mean, std = torch.zeros(4, requires_grad=True), torch.ones(4, requires_grad=True)
    z = draw_gaussian(mean, std, draw="sample", generator=torch.Generator().manual_seed(0))
    by_mean, by_std = torch.autograd.grad(z.sum(), (mean, std))
    assert torch.equal(by_mean, torch.ones(4))
    assert torch.equal(by_std, z.detach())


def test_standard_deviations_are_positive_however_negative_the_numbers():
    mean, std = mean_and_std(torch.tensor([1.0, 2.0, -1e4, 1e4]), typical_std=0.1)
    assert torch.equal(mean, torch.tensor([1.0, 2.0]))
    assert 0 < std[0] < 1e-3
    torch.testing.assert_close(std[1], torch.tensor(1e4), rtol=1e-3, atol=0)


@pytest.mark.parametrize("typical", [0.01, 0.7, 3.0])
def test_zeros_stand_for_the_typical_standard_deviation(typical: float):
    _, std = mean_and_std(torch.zeros(8), typical_std=typical)
    torch.testing.assert_close(std, torch.full((4,), typical), atol=1e-4 + 1e-6, rtol=0)
