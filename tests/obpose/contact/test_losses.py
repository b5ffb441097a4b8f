import math

import pytest
import torch

from obpose.contact.components import OFFSETS, offsets, shifted
from obpose.contact.losses import affinity_loss, embedding_loss, foreground_loss


def halves(height: int = 8, width: int = 8) -> torch.Tensor:
    """Background in the first row, below it two objects side by side."""
    labels = torch.ones(1, height, width, dtype=torch.int64)
    labels[:, :, width // 2 :] = 2
    labels[:, 0] = 0
    return labels


def test_ignorance_costs_log_two():
    labels, none = halves(), torch.zeros(1, OFFSETS, 8, 8)
    assert foreground_loss(none[:, 0], labels).item() == pytest.approx(math.log(2))
    assert affinity_loss(none, labels).item() == pytest.approx(math.log(2))


def test_true_affinities_cost_nothing_and_only_objects_count():
    labels, logits = halves(), torch.full((1, OFFSETS, 8, 8), 30.0)
    for channel, offset in enumerate(offsets(1)):
        here, there = shifted((8, 8), offset)
        same = labels[:, *here] == labels[:, *there]
        logits[:, channel, *here] = torch.where(same, 30.0, -30.0)
    assert affinity_loss(logits, labels).item() == pytest.approx(0, abs=1e-6)
    logits[:, :, 0] = -logits[:, :, 0]  # pairs with the background
    assert affinity_loss(logits, labels).item() == pytest.approx(0, abs=1e-6)


def test_pairs_of_different_objects_weigh_twice_as_much():
    labels = torch.tensor([[[1, 1, 2]]])
    logits = torch.zeros(1, OFFSETS, 1, 3)
    logits[0, 0, 0] = torch.tensor([5.0, 5.0, 0.0])  # right, then wrong
    right, wrong = math.log1p(math.exp(-5)), math.log1p(math.exp(5))
    assert affinity_loss(logits, labels).item() == pytest.approx((right + 2 * wrong) / 3, rel=1e-4)


def test_embeddings_within_the_margins_cost_nothing():
    labels = halves()
    embedding = torch.zeros(1, 3, 8, 8)
    embedding[:, 0] = torch.where(labels == 2, 3.1, 0.0)
    embedding[:, 1, 1::2] = 0.3
    assert [float(term) for term in embedding_loss(embedding, labels)] == pytest.approx([0, 0], abs=1e-5)


def test_pull_and_push_are_squared_distances_beyond_the_margins():
    labels = torch.tensor([[[1, 1, 2, 2]]])
    embedding = torch.tensor([[[[-1.0, 1.0, 1.0, 3.0]]]])  # means 0 and 2, all pixels 1 from theirs
    pull, push = embedding_loss(embedding, labels)
    assert pull.item() == pytest.approx(0.7**2, rel=1e-3)
    assert push.item() == pytest.approx(1, rel=1e-3)


def test_objects_pull_by_the_root_of_their_size():
    labels = torch.tensor([[[1] * 4 + [2] * 16]])
    embedding = torch.zeros(1, 1, 1, 20)
    embedding[..., :4] = torch.tensor([-1.0, 1.0, -1.0, 1.0])  # all pixels of the smaller one 1 from their mean
    pull, _ = embedding_loss(embedding, labels)
    assert pull.item() == pytest.approx(0.7**2 * 2 / (2 + 4), rel=1e-3)


def test_images_without_objects_cost_nothing():
    labels, embedding = torch.zeros(2, 8, 8, dtype=torch.int64), torch.randn(2, 3, 8, 8)
    assert [float(term) for term in embedding_loss(embedding, labels)] == [0, 0]
    assert affinity_loss(torch.randn(2, OFFSETS, 8, 8), labels).item() == 0
