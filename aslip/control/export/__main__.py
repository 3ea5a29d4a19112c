"""Export a policy to ONNX, with everything that a robot needs to run it, and check the file.

    python -m aslip.control.export --policy directions --out directions.onnx

Motor targets are compared with PyTorch's, on the golden trace and at further policy steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of an export."""

    policy: str = "directions"
    """Name of a shipped policy, policy file, or folder of a training run."""
    out: Path = Path("policy.onnx")
    """ONNX file to write."""
    library: str | None = None
    """Gait library: name of a shipped one, or file; by default that of the policy's stack."""
    steps: int = 2000
    """Number of policy steps, besides the golden trace, on which the file must agree with
    PyTorch."""


def main(config: Config) -> None:
    """Export a policy, and compare the file with PyTorch."""
    print(f"exporting {config.policy} to {config.out} ...", flush=True)
    import onnxscript  # noqa: F401 - first, as its extra has onnx, too

    from aslip.control.export import export_policy
    from aslip.library import GaitLibrary

    chosen = None if config.library is None else GaitLibrary.load(config.library)
    exported = export_policy(config.policy, config.out, chosen, steps=config.steps)
    print(f"golden trace: largest difference {exported.verify():.2g} rad from PyTorch")
    print(f"{config.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    with one_line_errors():
        main(command_line(Config))
