"""TorchRL environments of Cassie: one contract, two implementations."""

from aslip.envs.base import CassieEnv
from aslip.envs.batch import BatchCassieEnv
from aslip.envs.dm_control import DmControlCassieEnv

__all__ = ["BatchCassieEnv", "CassieEnv", "DmControlCassieEnv"]
