"""Observations of very different means and scales."""

import torch


def random_observations(num: int, seed: int = 0) -> torch.Tensor:
    """Random observations (num, 64)."""
    generator = torch.Generator().manual_seed(seed)
    scale, shift = 10 ** torch.linspace(-2, 3, 64), torch.linspace(-50, 50, 64)
    return shift + scale * torch.randn(num, 64, generator=generator)
