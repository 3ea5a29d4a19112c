"""Policy step of a controller as one ONNX graph, traced from the functions of `Controller`."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import onnx
import onnxscript  # noqa: F401 - for torch.onnx
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from aslip.control.controller import PATH_ERROR, Controller
from aslip.control.estimates import POSITION, standing_estimate
from aslip.control.exported_file import check_graph
from aslip.control.robot_frame import hold_estimate, place_on_path
from aslip.errors import ConfigurationError
from aslip.library.region import COMMANDS
from aslip.policy import entry_names
from aslip.robot import Robot
from aslip.transforms import PATH_SIZES
from aslip.transforms.path import advance_frame, advance_heading
from aslip.transforms.rotation import rotate_about_vertical

_WORLD = "frame of the estimates, z up against gravity"
_HEADING = "heading frame: z up against gravity, x along the heading"
_MOVING = "moving frame of aslip.library.Reference"
_PELVIS = "pelvis"

# entry of an estimate -> unit, frame
_ESTIMATE = {
    "height": ("m", "above the ground below the pelvis"),
    "orientation": ("1", "pelvis to " + _WORLD),
    "velocity": ("m/s", _WORLD),
    "angular_velocity": ("rad/s", _PELVIS),
    "acceleration": ("m/s^2", _PELVIS + ", without gravity"),
    "motor_position": ("rad", ""),
    "motor_velocity": ("rad/s", ""),
    "joint_position": ("rad", ""),
    "joint_velocity": ("rad/s", ""),
}
_AXES = {1: ("z",), 3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}
_MODES = "0 walks, 1 stops, 2 stands, 3 starts"
# opset that onnxruntime supports since 1.17
_OPSET = 18


@dataclass(frozen=True)
class Entry:
    """Input or output of the graph."""

    name: str
    value: Tensor
    """Example (1, k)."""
    elements: tuple[str, ...] = ()
    """Names of the k numbers."""
    unit: str = ""
    frame: str = ""
    meaning: str = ""

    def describe(self) -> dict[str, Any]:
        """Description in the contract."""
        described = {
            "name": self.name,
            "dtype": str(self.value.dtype).removeprefix("torch."),
            "shape": list(self.value.shape),
        }
        words = {
            "elements": list(self.elements),
            "unit": self.unit,
            "frame": self.frame,
            "meaning": self.meaning,
        }
        return {**described, **{name: text for name, text in words.items() if text}}


class PolicyStep(nn.Module):
    """Policy step of a controller as a module, for one robot that estimates its own state.

    Inputs (1, k) are the entries of an estimate, `command`, `first`, and values of the last step:
    `last_heading`, `last_phase`, `last_action`, `last_estimate`, with several axes of the command
    `last_filtered_command`, and the policy's hidden states. A policy that stands also takes `stand`
    and `last_mode`; one that observes its distance from the path takes `position`, `last_origin`
    and `last_path_error`. At a first step, `first` is True, `last_heading` and `last_phase` are
    those of the start, `last_origin` the position of the pelvis, and the other last values have no
    effect.

    Args:
        controller: the controller.

    Raises:
        ConfigurationError: the policy observes entries that a robot does not estimate itself.
    """

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        # registered, so that weights and tables become initialisers of the graph
        self.policy, self.library = controller.policy, controller.library
        self._controller, self._robot = controller, controller.estimator.robot
        self._along_path = self.library.command_size > 1
        names = entry_names(controller.observation)
        self._placed = self._along_path and PATH_ERROR in controller.observation
        hidden = [name for name in names if not (self._placed and name == "/".join(PATH_ERROR))]
        if unknown := [name for name in hidden if name.startswith(("odometry", "estimator"))]:
            raise ConfigurationError(
                f"the policy observes {unknown}, which robots do not estimate themselves, so it"
                " cannot be exported"
            )
        state = controller.start(standing_estimate(self._robot)).tensordict
        memory = cast("TensorDictBase", state.get("next", TensorDict()))
        self._memory = {name: cast("Tensor", memory[name]) for name in memory.keys()}  # noqa: SIM118
        self.inputs = self._inputs(state)
        with torch.no_grad():
            values = self._step(*(entry.value for entry in self.inputs))
        self.outputs = [_output(name, value, self._robot) for name, value in values.items()]
        last = [entry.name for entry in self.inputs if entry.name.startswith("last_")]
        self.feedback = {name.removeprefix("last_"): name for name in last}
        """Output -> input that takes its value at the next step."""

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        """Compute the values of `outputs` from those of `inputs`, in their orders."""
        return tuple(self._step(*values).values())

    def _step(self, *values: Tensor) -> dict[str, Tensor]:
        given = dict(zip((entry.name for entry in self.inputs), values, strict=True))
        first = given["first"]
        sizes = self._robot.estimate_sizes
        parts = given["last_estimate"].split(list(sizes.values()), dim=-1)
        last = dict(zip(sizes, parts, strict=True))
        commands = self._commands(given, last)
        heading = self._heading(given)
        estimate = {name: given[name] for name in sizes}
        present: dict[str, Any] = {
            **commands,
            "heading": heading,
            "estimate": hold_estimate(estimate, heading, last),
            "last_action": torch.where(first, 0.0, given["last_action"]),
            # hidden states of first steps are set to zero here
            "is_init": torch.tensor([[False]] * len(first)),
        }
        if self._placed:
            present["odometry"] = self._odometry(given, heading, commands.get("mode"))
        for name in self._memory:
            state = given[f"last_{name}"]
            present[name] = torch.where(first.reshape(-1, *[1] * (state.ndim - 1)), 0.0, state)
        acting = TensorDict(present, batch_size=[len(first)])
        return self._results(self._controller.act(acting).tensordict)

    def _commands(
        self, given: Mapping[str, Tensor], last: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Command, phase, and what else follows from commands and last estimate."""
        steering, first = self._controller.steering, given["first"]
        command, stand = self.library.nearest(given["command"]), given.get("stand")
        started = steering.begin(command, given["last_phase"], stand)
        names = ("phase", "filtered_command", "mode")
        past = {name: given[f"last_{name}"] for name in names if f"last_{name}" in given}
        following = steering.advance({**past, "estimate": last}, command, stand)
        now = {name: torch.where(first, started[name], following[name]) for name in past}
        return {**following, **now}

    def _heading(self, given: Mapping[str, Tensor]) -> Tensor:
        """Yaw (n, 1) that counts as straight ahead, turned by the filtered yaw rate [rad]."""
        before = given["last_heading"]
        if not self._along_path:
            return before
        after = advance_heading(before, given["last_filtered_command"])
        return torch.where(given["first"], before, after)

    def _odometry(
        self, given: Mapping[str, Tensor], heading: Tensor, mode: Tensor | None
    ) -> dict[str, Tensor]:
        """Origin of the path of the command, and distance of the pelvis from it."""
        first, before = given["first"], given["last_heading"].float()
        place = rotate_about_vertical(given[POSITION], -heading)
        command, last = given["last_filtered_command"], given["last_origin"]
        error = given["last_path_error"]
        origin, after = advance_frame(last, before, command, error)
        origin, after = torch.where(first, last, origin), torch.where(first, before, after)
        return place_on_path(place, origin, after, error, mode)

    def _results(self, state: TensorDictBase) -> dict[str, Tensor]:
        """Values of the outputs by name."""
        names = ["motor_target", "action", "observation", "phase", "heading"]
        names += ["filtered_command"] if self._along_path else []
        names += ["mode"] if self._controller.steering.stands else []
        sizes = self._robot.estimate_sizes
        estimate = torch.cat([cast("Tensor", state["estimate", name]) for name in sizes], dim=-1)
        values = {"nearest_command": state["command"], **{name: state[name] for name in names}}
        values |= {"estimate": estimate, **{name: state["next", name] for name in self._memory}}
        if self._placed:
            values |= {name: state["odometry", name] for name in PATH_SIZES}
        # copies: outputs of a graph must be distinct from its inputs and from each other
        return {n: cast("Tensor", v).clone() for n, v in values.items()}

    def _inputs(self, state: TensorDictBase) -> list[Entry]:
        """Inputs of the graph, with examples from a controller's entries."""
        size, robot = self.library.command_size, self._robot
        joints = {"motor": robot.motor_names, "joint": robot.joint_names}
        entries = []
        for name, width in robot.estimate_sizes.items():
            unit, frame = _ESTIMATE[name]
            elements = joints.get(name.split("_")[0]) or _AXES.get(width, ())
            value = torch.tensor(standing_estimate(robot)[name][None])
            entries.append(Entry(name, value, elements, unit, frame))
        command, phase = torch.zeros(1, size), torch.zeros(1, 1)
        entries += [
            _HEADING_INPUT,
            Entry("command", command, _axes(size), "m/s, rad/s", _MOVING),
            Entry("first", torch.ones(1, 1, dtype=torch.bool), meaning="first step of the robot"),
            Entry("last_phase", phase, meaning="stride fraction; at a first step to begin at"),
            Entry("last_action", state["action"], elements=robot.motor_names, unit="rad"),
            Entry("last_estimate", torch.zeros(1, sum(robot.estimate_sizes.values()))),
        ]
        if self._along_path:
            entries.append(Entry("last_filtered_command", command, elements=_axes(size)))
        if self._controller.steering.stands:
            entries += _STAND_INPUTS
        if self._placed:
            entries += _PATH_INPUTS
        return entries + [
            Entry(f"last_{name}", value, meaning="hidden state of the policy")
            for name, value in self._memory.items()
        ]


# from NumPy: not changed by torch's defaults at the time of the import
_ZEROS = torch.from_numpy(np.zeros((1, 3)))
_HEADING_INPUT = Entry(
    "last_heading",
    _ZEROS[:, :1],
    unit="rad",
    frame=_WORLD,
    meaning="yaw that counts as straight ahead; at a first step usually that of the orientation",
)

_STAND_INPUTS = (
    Entry("stand", _ZEROS[:, :1].float(), meaning="1 to stand, 0 to walk"),
    Entry("last_mode", _ZEROS[:, :1].float(), meaning=_MODES),
)
_PATH_INPUTS = (
    Entry(
        POSITION,
        _ZEROS[:, :3],
        ("x", "y", "z"),
        "m",
        _WORLD,
        "position of the pelvis; z has no effect",
    ),
    Entry(
        "last_origin",
        _ZEROS[:, :3].float(),
        unit="m",
        frame=_WORLD,
        meaning="origin of the moving frame; at a first step that of the pelvis, with z zero",
    ),
    Entry("last_path_error", _ZEROS[:, :2].float(), unit="m", frame=_HEADING),
)


def _axes(size: int) -> tuple[str, ...]:
    """Names of the components of a command."""
    return tuple(name.replace(" ", "_") for name, _ in COMMANDS[:size])


def _output(name: str, value: Tensor, robot: Robot) -> Entry:
    """Describe an output of the graph."""
    motors = robot.motor_names
    known = {
        "motor_target": Entry(name, value, motors, "rad"),
        "action": Entry(name, value, motors, "rad", meaning="added to the baseline"),
        "observation": Entry(name, value, meaning="entries of observation_names, in order"),
        "nearest_command": Entry(name, value, meaning="command moved into the library's region"),
        "phase": Entry(name, value, meaning="stride fraction; 0 is left lift-off"),
        "heading": Entry(name, value, unit="rad", frame=_WORLD, meaning="yaw straight ahead"),
        "mode": Entry(name, value, meaning=_MODES),
        "filtered_command": Entry(name, value, _axes(value.shape[-1]), "m/s, rad/s"),
        "estimate": Entry(name, value, frame=_HEADING, meaning="entries of the estimate, in order"),
    }
    return known.get(name, Entry(name, value))


def trace_graph(
    module: nn.Module, inputs: Sequence[Entry], outputs: Sequence[Entry]
) -> onnx.ModelProto:
    """Trace a module to a graph of standard operators with its weights inside.

    Args:
        module: module of tensors.
        inputs: inputs of the module; the shapes of the examples become those of the graph.
        outputs: outputs of the module.

    Returns:
        The graph, checked and without notes of the exporter.

    Raises:
        ConfigurationError: the module cannot be traced, or its graph would be refused, see
            `aslip.control.exported_file.check_graph`.
    """
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            program = torch.onnx.export(
                module.eval(),
                # copies: one tensor for two inputs would make them one
                tuple(entry.value.clone() for entry in inputs),
                input_names=[entry.name for entry in inputs],
                output_names=[entry.name for entry in outputs],
                opset_version=_OPSET,
                dynamo=True,
                verbose=False,
            )
        except Exception as error:  # the exporter's errors have no common class
            raise ConfigurationError(f"the policy cannot be traced: {error}") from error
    model = cast("onnx.ModelProto", cast("Any", program).model_proto)
    _strip(model)
    onnx.checker.check_model(model)
    try:
        check_graph(model)
    except ValueError as error:
        raise ConfigurationError(f"the policy cannot be exported: {error}") from error
    return model


def _strip(model: onnx.ModelProto) -> None:
    """Remove the exporter's notes: paths of source files, and shapes of intermediate values."""
    graph = model.graph
    del graph.value_info[:]
    for part in (model, graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        del part.metadata_props[:]
        part.doc_string = ""
