"""Write `tests/data/golden.mcap`, the log that pins the format: `python -m tests.log.golden`.

Write it again, with a new `aslip.log.messages.FORMAT`, only when messages change on purpose.
"""

from pathlib import Path

import torch
from tensordict import TensorDict

import aslip
from aslip.envs import default_stack
from aslip.log import Recorder

GOLDEN = Path(__file__).parents[1] / "data" / "golden.mcap"


def main(path: Path) -> None:
    """Log 5 steps at 0.5 m/s, then an episode of 12 steps with a payload."""
    stack = {**default_stack(), "recorder": Recorder(path, overwrite=True)}
    env = aslip.make_env(seed=7, num_threads=1, stack=stack)
    policy = aslip.load_policy("straight")
    start = TensorDict(command=torch.full((1, 1), 0.5), phase=torch.zeros(1, 1), batch_size=1)
    for steps, payload in ((5, 0.0), (12, 3.0)):
        env.base_env.set_dynamics({"payload": payload})
        env.rollout(steps, policy, auto_reset=False, tensordict=env.reset(start))
    env.close()


if __name__ == "__main__":
    main(GOLDEN)
