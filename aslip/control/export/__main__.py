"""Export a policy to ONNX, with everything that a robot needs to run it, and check the file.

    python -m aslip.control.export --policy aslip --out aslip.onnx

The check compares motor targets with PyTorch's, on the golden trace and at random states.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors

if TYPE_CHECKING:
    from aslip.control.exported import ExportedController


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of an export."""

    policy: str = "aslip"
    """Name of a shipped policy, policy file, or folder of a training run."""
    out: Path = Path("policy.onnx")
    """ONNX file to write."""
    library: str | None = None
    """Gait library: name of a shipped one, or file; by default that of the policy's stack."""
    samples: int = 100_000
    """Number of random states at which the file of a whole policy is compared with PyTorch."""
    network: bool = False
    """Export the network alone, from observation to action, with mjlab's metadata; it is not
    compared."""
    leapp: bool = False
    """Write a pipeline file for LEAPP beside the ONNX file, too."""

    def __post_init__(self) -> None:
        """Check that no setting would be without effect.

        Raises:
            ConfigurationError: a setting does not go with another one, or is out of range.
        """
        super().__post_init__()
        if self.network and self.leapp:
            raise ConfigurationError(
                "leapp describes a whole policy, and network exports a part of one: choose one"
            )
        if self.samples < 0:
            raise ConfigurationError(f"samples must be 0 or more, got {self.samples}")


def main(config: Config) -> None:
    """Export a policy, and compare the file with PyTorch.

    Raises:
        SystemExit: motor targets differ by more than the contract allows; nothing is written.
    """
    print(f"exporting {config.policy} to {config.out} ...", flush=True)
    from tqdm import tqdm

    from aslip.control import Controller
    from aslip.control.contract import TOLERANCE
    from aslip.control.export import compare, export_network, export_policy, write_pipeline
    from aslip.library import GaitLibrary

    chosen = None if config.library is None else GaitLibrary.load(config.library)
    controller = Controller(config.policy, chosen)
    if config.network:
        export_network(config.policy, config.out, controller.library)
        print(f"{config.out.stat().st_size / 1e6:.1f} MB")
        return

    def check(exported: ExportedController) -> None:
        print(f"golden trace: largest difference {exported.verify():.2g} rad from PyTorch")
        if config.samples:
            largest = compare(exported, controller, config.samples, progress=tqdm)
            print(f"{config.samples} random states: {largest:.2g} rad")
            if not largest <= TOLERANCE:
                raise SystemExit(f"error: more than {TOLERANCE:g} rad; {config.out} is not written")

    exported = export_policy(config.policy, config.out, controller.library, check=check)
    if config.leapp:
        write_pipeline(exported, config.out.with_suffix(".yaml"))
    print(f"{config.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    with one_line_errors():
        main(command_line(Config))
