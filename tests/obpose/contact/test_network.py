import torch

from obpose.contact.network import Residual, UNet


def test_networks_take_images_of_any_size():
    network = UNet(3, 5)
    assert network(torch.randn(2, 3, 13, 21)).shape == (2, 5, 13, 21)


def test_residual_blocks_start_as_the_identity():
    x = torch.randn(2, 24, 5, 7, generator=torch.Generator().manual_seed(0))
    assert torch.equal(Residual(24)(x), x)
