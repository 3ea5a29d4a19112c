"""Policy: normaliser, networks, and files that are intact, safe and checked on loading."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor

import aslip
from aslip.base.archive import as_json, npy
from aslip.errors import AssetError, ConfigurationError, FileDamagedError, ShapeError
from aslip.policy import (
    CARD,
    PolicyShape,
    RunningNormalizer,
    action_layers,
    action_scale,
    entry_names,
    gaussian_actor,
    make_actor,
    make_critic,
    make_recurrent_actor,
    policy_stack,
    read_card,
    save_policy,
)
from aslip.transforms import DIRECTION_TABLE
from tests.contracts.archives import forge_archive, read_zip
from tests.helpers import MakeEnv
from tests.policy.inputs import random_observations


@pytest.fixture
def actor() -> ProbabilisticActor:
    """Policy with a trained normaliser, whose actions are well away from zero."""
    torch.manual_seed(0)
    normalizer = RunningNormalizer(64)
    normalizer.update(random_observations(100))
    actor = make_actor(normalizer)
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return actor


def _input(num: int = 20) -> TensorDict:
    return TensorDict(observation=random_observations(num, seed=9), batch_size=num)


def test_the_actor_is_deterministic_unless_asked_to_explore(
    actor: ProbabilisticActor,
) -> None:
    first, second = actor(_input())["action"], actor(_input())["action"]
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        torch.testing.assert_close(actor(_input())["action"], first, rtol=0, atol=0)
    with set_exploration_type(ExplorationType.RANDOM):
        sampled, again = actor(_input())["action"], actor(_input())["action"]
    assert not torch.equal(sampled, again)


def test_exploration_has_the_fixed_standard_deviation(
    actor: ProbabilisticActor,
) -> None:
    """It is exp(-2), about 0.135 rad, for any input."""
    assert PolicyShape().std == pytest.approx(math.exp(-2))
    td = TensorDict(observation=random_observations(1).expand(4000, 64), batch_size=4000)
    with torch.no_grad():
        mean = actor(td.clone())["action"][0]
        with set_exploration_type(ExplorationType.RANDOM):
            data = actor(td)
    np.testing.assert_allclose(data["scale"], math.exp(-2), rtol=1e-6)
    deviation = data["action"] - mean
    np.testing.assert_allclose(deviation.std(dim=0), math.exp(-2), rtol=0.05)
    np.testing.assert_allclose(deviation.mean(dim=0), 0, atol=0.01)
    expected = torch.distributions.Normal(mean, math.exp(-2)).log_prob(data["action"]).sum(-1)
    torch.testing.assert_close(data["action_log_prob"], expected, rtol=1e-4, atol=1e-4)


def test_training_starts_near_the_reference() -> None:
    torch.manual_seed(1)
    action = make_actor(RunningNormalizer(64))(_input())["action"]
    assert 0 < action.abs().max() < 0.05


def test_actor_and_critic_share_only_the_normalizer() -> None:
    normalizer = RunningNormalizer(64)
    actor, critic = make_actor(normalizer), make_critic(normalizer)
    assert sum(module is normalizer for module in actor.modules()) == 1
    assert sum(module is normalizer for module in critic.modules()) == 1
    assert not {id(p) for p in actor.parameters()} & {id(p) for p in critic.parameters()}


def test_action_is_independent_of_batch(
    actor: ProbabilisticActor,
) -> None:
    together = actor(_input())["action"]
    alone = torch.stack([actor(td)["action"] for td in _input()])
    torch.testing.assert_close(alone, together, rtol=1e-4, atol=1e-5)


# ---------------------------------------------------------------- the file


@pytest.fixture
def file(actor: ProbabilisticActor, tmp_path: Path) -> Path:
    path = tmp_path / "policy.zip"
    save_policy(path, actor, PolicyShape(), {"seed": 3})
    return path


def test_a_loaded_policy_gives_the_same_actions_bit_for_bit(
    actor: ProbabilisticActor, file: Path
) -> None:
    loaded = aslip.load_policy(file)
    torch.testing.assert_close(
        loaded(_input())["action"], actor(_input())["action"], rtol=0, atol=0
    )
    assert not loaded.training
    with set_exploration_type(ExplorationType.RANDOM):
        assert torch.allclose(loaded(_input())["scale"], torch.tensor(math.exp(-2)))


def test_refuses_unknown_policy_name(tmp_path: Path) -> None:
    for name in ("no_such_policy", tmp_path, str(tmp_path / "gone.zip")):
        with pytest.raises(AssetError, match="neither a file, nor the folder of a run"):
            aslip.load_policy(name)


@pytest.mark.parametrize(
    "change",
    [
        {"std": 0},
        {"std": "a"},
        {"hidden": [-1, 256]},
        {"hidden": "ab"},
        {"observation_size": "64"},
        None,
    ],
)
def test_refuses_invalid_card(file: Path, change: dict | None) -> None:
    parts = read_zip(file.read_bytes())
    card = json.loads(parts[CARD])
    card["shape"] = None if change is None else card["shape"] | change
    file.write_bytes(forge_archive({**parts, CARD: as_json(card)}))
    with pytest.raises(FileDamagedError, match=r"policy\.zip"):
        aslip.load_policy(file)
    with pytest.raises(FileDamagedError, match=r"policy\.zip"):
        policy_stack(file)


def test_refuses_policy_for_another_observation(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aslip.policy.file._TABLES", [(("estimate", "height"), "new")])
    with pytest.raises(ConfigurationError, match=r"lacks \['new'\].*has \['estimate/orientation"):
        aslip.load_policy(file)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"hidden": [10**9, 10**9]}, "describes a network of 10000000"),
        ({"hidden": [1] * 10**5}, "in 100000 hidden layers, and it has"),
        ({"observation_size": 10**9}, "describes a network of 256000"),
        ({"hidden": [255, 256]}, r"size mismatch for .*\[256, 64\].*\[255, 64\]"),
        ({"hidden": [256]}, "Unexpected key.*4.weight"),
    ],
)
def test_refuses_oversized_network_before_allocation(file: Path, shape: dict, message: str) -> None:
    parts = read_zip(file.read_bytes())
    card = json.loads(parts[CARD])
    card["shape"] |= shape
    file.write_bytes(forge_archive({**parts, CARD: as_json(card)}))
    with pytest.raises(FileDamagedError, match=message):
        aslip.load_policy(file)


@pytest.mark.parametrize("number", [math.nan, -math.inf])
def test_refuses_nonfinite_weights(actor: ProbabilisticActor, file: Path, number: float) -> None:
    parts, before = read_zip(file.read_bytes()), file.read_bytes()
    name = next(name for name, value in actor.named_parameters() if value.ndim == 2)
    weights = actor.state_dict()[name]
    weights[3, 4] = number
    with pytest.raises(ConfigurationError, match=rf"{name}' is not finite"):
        save_policy(file, actor, PolicyShape())
    assert file.read_bytes() == before
    file.write_bytes(forge_archive({**parts, f"weights/{name}.npy": npy(weights.numpy())}))
    with pytest.raises(FileDamagedError, match=rf"{name}' is not finite"):
        aslip.load_policy(file)


def _other_activation() -> nn.Module:
    """An actor with equal names and weights that computes another function."""
    actor = make_actor(RunningNormalizer(64))
    net = next(m for m in actor.modules() if isinstance(m, nn.ReLU))
    net.forward = torch.tanh
    return actor


@pytest.mark.parametrize(
    ("make_one", "shape", "message"),
    [
        (lambda: make_recurrent_actor(RunningNormalizer(64)), PolicyShape(), "network="),
        (lambda: nn.Linear(64, 10), PolicyShape(), "Missing key"),
        (lambda: make_actor(RunningNormalizer(64)), PolicyShape(hidden=(256, 128)), "128, 256"),
        (lambda: make_actor(RunningNormalizer(64)), PolicyShape(symmetric=True), "Missing key"),
        (lambda: make_actor(RunningNormalizer(64)).double(), PolicyShape(), "Double"),
        (_other_activation, PolicyShape(), "actions differ"),
    ],
)
def test_refuses_to_save_unloadable_actor(
    file: Path, make_one: Any, shape: PolicyShape, message: str
) -> None:
    before = file.read_bytes()
    with pytest.raises(ConfigurationError, match=message):
        save_policy(file, make_one(), shape)
    assert file.read_bytes() == before


def test_refuses_to_save_an_observation_of_no_named_stack(file: Path) -> None:
    before = file.read_bytes()
    own = [*DIRECTION_TABLE[:-1], ("truth", "time")]
    shape = PolicyShape(7)
    actor = make_recurrent_actor(RunningNormalizer(7), shape)
    given: dict[str, Any] = {"network": make_recurrent_actor, "observation": own}
    (last,) = entry_names(DIRECTION_TABLE[-1:])
    message = rf"lacks \['{last}'\] and its observation also has \['truth/time'\]; give stack=None"
    with pytest.raises(ConfigurationError, match=message):
        save_policy(file, actor, shape, **given)
    assert file.read_bytes() == before
    save_policy(file, actor, shape, stack=None, **given)


def test_saving_draws_no_random_numbers(actor: ProbabilisticActor, tmp_path: Path) -> None:
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    save_policy(tmp_path / "policy.zip", actor, PolicyShape())
    assert torch.equal(torch.rand(4), expected)


def test_rollouts_carry_no_graph(make: MakeEnv) -> None:
    """Memory would grow with every step."""
    policy, env = aslip.load_policy("straight"), make(num_envs=2)
    data = env.rollout(3, policy)
    assert not any(leaf.requires_grad for leaf in data.values(True, True))
    # no graph during training either
    data = env.rollout(3, policy.requires_grad_(True))
    assert data["action"].requires_grad
    assert not data["next", "reward"].requires_grad
    assert not data["next", "last_action"].requires_grad


def test_error_names_observation_sizes(make: MakeEnv) -> None:
    with pytest.raises(ShapeError, match="reads 64 numbers, the observation has 49"):
        make(stack="single_reference").rollout(2, aslip.load_policy("straight"))
    with pytest.raises(ShapeError, match="reads 49 numbers, the observation has 64"):
        make().rollout(2, aslip.load_policy("single_reference"))


def test_symmetric_policy_refuses_stacked_frames() -> None:
    """For example, frames stacked by another transform."""
    shape = PolicyShape(192, symmetric=True)
    for make_net in (make_actor, make_critic):
        with pytest.raises(ConfigurationError, match=r"have 64 numbers, .* has 192.*no-symmetric"):
            make_net(RunningNormalizer(192), shape)
    make_actor(RunningNormalizer(192), PolicyShape(192))


# ----------------------------------------------------------------- own networks


def make_tanh_actor(
    normalizer: RunningNormalizer, shape: PolicyShape, observation: Any = ()
) -> ProbabilisticActor:
    """Custom actor, with another activation than the built-in networks."""
    layers = action_layers(shape, 32, ())
    net = nn.Sequential(normalizer, nn.Linear(64, 32), nn.Tanh(), layers, action_scale(shape))
    return gaussian_actor(TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]))


def test_custom_network_loads_with_given_function(tmp_path: Path) -> None:
    actor = make_tanh_actor(RunningNormalizer(64), PolicyShape())
    path = tmp_path / "policy.zip"
    with pytest.raises(ConfigurationError, match=r"that 'mlp' makes.*network="):
        save_policy(path, actor, PolicyShape())
    save_policy(path, actor, PolicyShape(), network=make_tanh_actor)
    assert read_card(path)["network"] == f"{__name__}.make_tanh_actor"
    with pytest.raises(ConfigurationError, match=r"made by '.*make_tanh_actor', which is not"):
        aslip.load_policy(path)
    loaded = aslip.load_policy(path, make_tanh_actor)
    assert torch.equal(loaded(_input())["action"], actor(_input())["action"])
    with pytest.raises(FileDamagedError, match="Missing key"):
        aslip.load_policy(path, make_actor)


def test_mistake_in_custom_network_function_is_not_reported_as_damage(file: Path) -> None:
    def fails(*arguments: Any) -> ProbabilisticActor:
        raise TypeError(f"own mistake with {len(arguments)} arguments")

    with pytest.raises(TypeError, match="own mistake with 3 arguments"):
        aslip.load_policy(file, fails)


def test_card_cannot_import_code(file: Path) -> None:
    parts = read_zip(file.read_bytes())
    card = json.loads(parts[CARD]) | {"network": "os.system"}
    file.write_bytes(forge_archive({**parts, CARD: as_json(card)}))
    with pytest.raises(ConfigurationError, match=r"'os\.system', which is not imported"):
        aslip.load_policy(file)
