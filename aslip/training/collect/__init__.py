"""Samples from robots in this process, in several processes, or on several machines.

    collector = make_collector(make_env, actor, kind="ray", num_envs=256, samples=2048)
    with collector:
        for data in collector:
            ...  # train the actor; the next batch is by what it is then

| kind | robots are in | needs |
|---|---|---|
| `single` | this process | |
| `distributed` | processes on this machine, which speak gloo | |
| `ray` | actors on this machine, or on a cluster | `pip install 'aslip[ray]'` |

On a cluster the package must be installed on every machine, in the same version:

    ray start --head                            # on one
    ray start --address=HOST:6379               # on each of the others
    RAY_ADDRESS=HOST:6379 python recipes/ppo_aslip.py --collector ray --num-collectors 8

The first prints a token by `ray get-auth-token`; the others and the recipe need it where Ray asks
for one, as `RAY_AUTH_MODE=token RAY_AUTH_TOKEN=...`.

Without `RAY_ADDRESS` a Ray of its own begins on the loopback address, without dashboard and usage
statistics, and ends with the collector.

Guarantees, for all kinds:

- a batch is (num_envs, T), time last; neighbouring rows are of the same collector, and no row has
  steps of two;
- the whole batch is by the weights and the normaliser that the actor has when it is asked for;
- the same seed leads to the same batches, with as many collectors and robots;
- after `shutdown`, and at the latest when this process has ended, however, so have all others; of a
  Ray that was killed, two agents take a minute to see it.

Traps:

- Processes are spawned: a script must not train at its import, but under
  `if __name__ == "__main__":`.
- Only what learning reads (`SENT`) is sent; a batch of `single` has everything.
- The state of `single` resumes exactly. That of others holds how many batches there were: their
  robots begin new episodes, with random numbers that no batch before has seen.
- TorchRL listens on all network interfaces, and asks no one who they are, while processes are told
  weights: a network that others share needs a firewall.
"""

from aslip.training.collect.base import SampleCollector
from aslip.training.collect.distributed import DistributedCollectors
from aslip.training.collect.local import LocalCollector
from aslip.training.collect.make import make_collector
from aslip.training.collect.ray import RayCollectors
from aslip.training.collect.remote import SENT, RemoteCollectors
from aslip.training.settings import CollectorKind, check_shares

__all__ = [
    "SENT",
    "CollectorKind",
    "DistributedCollectors",
    "LocalCollector",
    "RayCollectors",
    "RemoteCollectors",
    "SampleCollector",
    "check_shares",
    "make_collector",
]
