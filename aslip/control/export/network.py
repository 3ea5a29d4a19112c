"""Export of the network alone, for runners that assemble the observation themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from aslip.base.assets import user_path
from aslip.control.controller import Controller
from aslip.control.estimates import standing_estimate
from aslip.control.export.graph import Entry, trace_graph
from aslip.control.export.policy import mjlab_metadata, write_model
from aslip.library import GaitLibrary


def export_network(
    policy: str | Path | Controller, path: str | Path, library: GaitLibrary | None = None
) -> None:
    """Export the network of a policy, from observation to action, with mjlab's metadata.

    The normaliser is inside. The input is `obs` (1, o), the output `actions` (1, m) [rad], which is
    added to the reference; a hidden state goes from the output `h_out` to the input `h_in`, which
    is zero at the first step. Entries, units and frames of `obs` are those of `export_policy`.

    Args:
        policy: name of a shipped policy, a policy file, or a controller with a policy of your own.
        path: file to write; an existing one is replaced atomically.
        library: gaits; only the number of components of their command matters.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy cannot be traced.
        OSError: the file cannot be written; an existing one stays intact.
    """
    name = policy if isinstance(policy, str | Path) else type(policy.policy).__name__
    if isinstance(policy, str | Path):
        policy = Controller(policy, library)
    network = _Network(policy)
    model = trace_graph(network, network.inputs, network.outputs)
    write_model(model, mjlab_metadata(policy, str(name)), user_path(path))


class _Network(nn.Module):
    """Network of a policy, with its hidden states as inputs and outputs."""

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.policy = controller.policy
        found = controller.start(standing_estimate(controller.estimator.robot)).tensordict
        memory = cast("TensorDictBase", found.get("next", TensorDict()))
        self._memory = [str(key) for key in memory.keys()]  # noqa: SIM118, of a tensordict
        ends = [""] if len(self._memory) < 2 else [f"_{name}" for name in self._memory]
        self.inputs = [Entry("obs", cast("Tensor", found["observation"]))]
        self.outputs = [Entry("actions", cast("Tensor", found["action"]))]
        for name, end in zip(self._memory, ends, strict=False):
            self.inputs.append(Entry(f"h_in{end}", torch.zeros_like(memory[name])))
            self.outputs.append(Entry(f"h_out{end}", torch.zeros_like(memory[name])))

    def forward(self, obs: Tensor, *memory: Tensor) -> tuple[Tensor, ...]:
        given: dict[str, Any] = {"observation": obs, "is_init": torch.tensor([[False]])}
        given.update(zip(self._memory, memory, strict=True))
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            found = self.policy(TensorDict(given, batch_size=[1]))
        return found["action"], *(found["next", name] for name in self._memory)
