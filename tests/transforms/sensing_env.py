"""Environment of robots with sensors and no motors."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase


class SensingEnv(EnvBase):
    """N robots at rest, each with its own constant readings.

    Args:
        clean: packets `("sensors", name)` of the robots.
    """

    def __init__(self, clean: TensorDict) -> None:
        super().__init__(device="cpu", batch_size=clean.batch_size)
        self.clean, num = clean, len(clean)
        self.observation_spec = Composite(
            sensors=Composite(
                {
                    name: Unbounded(value.shape)
                    for name, value in cast("TensorDictBase", clean["sensors"]).items()
                },
                shape=(num,),
            ),
            shape=(num,),
        )
        single = torch.Size((num, 1))
        self.action_spec = Composite(action=Unbounded(single), shape=(num,))
        self.reward_spec = Unbounded(single)
        flag = Binary(shape=single, dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), shape=(num,))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        flag = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        rest = {"reward": flag.float(), "done": flag, "terminated": flag.clone()}
        return self.clean.clone().update(rest)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        del tensordict, kwargs
        return self.clean.clone()

    def _set_seed(self, seed: int | None) -> None: ...
