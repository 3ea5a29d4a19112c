"""Train as `ppo_aslip.py` does, with robots in several processes or on a cluster.

    python recipes/ppo_cluster.py --backend distributed --num-collectors 2   # this machine
    RAY_ADDRESS=HOST:6379 python recipes/ppo_cluster.py --num-collectors 8   # a Ray cluster

Learning stays in this process. `aslip/training/cluster.py` explains how to start a cluster, and the
guarantees. A resumed training starts new episodes, so unlike with `ppo_aslip.py` it differs from an
uninterrupted one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ppo_settings import PRESETS, Config, resume_command, training_settings

from aslip.errors import one_line_errors
from aslip.training.settings import check_shares


@dataclass(frozen=True)
class ClusterConfig(Config):
    """Settings of learning, and of the processes that simulate."""

    out: Path = Path("runs/ppo_cluster")
    """Folder of the run."""
    backend: Literal["ray", "distributed"] = "ray"
    """Ray actors, on this machine or the cluster at RAY_ADDRESS; or processes on this machine."""
    num_collectors: int = 2
    """Number of actors or processes, each with the same number of robots."""

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            ConfigurationError: a setting is invalid, or robots cannot be divided equally.
        """
        super().__post_init__()
        check_shares(self.num_envs, self.samples, self.num_collectors)


CLUSTER_PRESETS = {
    name: ClusterConfig(**{**vars(preset), "out": ClusterConfig.out})
    for name, preset in PRESETS.items()
}

if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = training_settings(CLUSTER_PRESETS)

from functools import partial

import ppo_aslip
from ppo_presets import environments

from aslip.training.cluster import DistributedCollectors
from aslip.training.ray import RayCollectors
from aslip.walking import WalkResult


def main(config: ClusterConfig, go_on: str = "resume=True") -> list[WalkResult]:
    """Train a policy and evaluate it at all speeds, see `ppo_aslip.main`.

    Args:
        config: the settings.
        go_on: command that resumes the training, for messages.
    """
    collectors = RayCollectors if config.backend == "ray" else DistributedCollectors
    return ppo_aslip.main(
        config,
        **environments(config.preset),
        make_collector=partial(collectors, num_collectors=config.num_collectors),
        go_on=go_on,
    )


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, go_on=resume_command(CONFIG))
