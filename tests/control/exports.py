"""Exported policies and estimates for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch

from aslip.control import Controller
from aslip.control.contract import seal
from aslip.control.estimates import split_estimate
from aslip.policy import PolicyShape, RunningNormalizer, make_recurrent_actor
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.transforms import DIRECTION_TABLE
from tests.library.standing import standing_library


def recurrent_controller() -> Controller:
    """Controller with an untrained GRU policy of large actions that walks anywhere, and stands."""
    torch.manual_seed(3)
    normalizer = RunningNormalizer(82)
    normalizer.update(torch.randn(100, 82))
    shape = PolicyShape(observation_size=82, hidden=(16, 16))
    actor = make_recurrent_actor(normalizer, shape)
    for name, weight in actor.named_parameters():
        if name.endswith("weight"):
            weight.data.mul_(3.0)
    policy = actor.eval().requires_grad_(False)
    return Controller(policy, standing_library(), observation=DIRECTION_TABLE, stands=True)


def estimate(row: np.ndarray) -> dict[str, np.ndarray]:
    """Entries of an estimate from a row of a golden trace."""
    return split_estimate(row[None], CASSIE)


def standing_packet() -> np.ndarray:
    """Packet (p,) of a robot that stands upright."""
    at, packet = CASSIE.packet_slices, np.zeros(CASSIE.packet_size)
    packet[at["motor_position"]] = CASSIE.standing[CASSIE.indices.motor_qpos]
    packet[at["joint_position"]] = CASSIE.standing[CASSIE.indices.joint_qpos]
    packet[at["orientation"]] = [1.0, 0.0, 0.0, 0.0]
    packet[at["accelerometer"]] = [0.0, 0.0, STANDARD_GRAVITY]
    return packet


def altered(source: Path, target: Path, **metadata: str) -> Path:
    """Copy of an exported policy with other metadata, sealed again."""
    model = onnx.load_from_string(source.read_bytes())
    entries = {prop.key: prop.value for prop in model.metadata_props if prop.key != "sha256"}
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {**entries, **metadata})
    target.write_bytes(seal(model.SerializeToString()))
    return target
