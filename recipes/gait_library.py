"""Rebuild the gait library: optimise gaits, solve the inverse kinematics, save, draw.

python recipes/gait_library.py --pictures docs/images    # the 21 that ship in assets/
python recipes/gait_library.py --out runs/my_gaits.npz --speeds 0.5 0.75 1.0
python recipes/gait_library.py --out runs/heavy.npz --model.mass 33.3 --objective integral
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from aslip.library import PAPER_SPEEDS
from aslip.rom import PHASE_SAMPLES, Objective, SlipParameters


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the library."""

    out: Path = Path("assets/gaits.npz")
    """File of the library."""
    speeds: tuple[float, ...] = PAPER_SPEEDS
    """Ascending forward speeds [m/s] (Sec. III-A)."""
    samples: int = PHASE_SAMPLES
    """Samples of a stride."""
    model: SlipParameters = field(default_factory=SlipParameters)
    """Model and bounds of the gaits."""
    objective: Objective = "mean"
    """Minimised quantity: the mean of u_l^2 + u_r^2 over the stride, or its integral, which is the
    paper's formula."""
    pictures: Path | None = None
    """Folder for the pictures; that of the library by default."""
    figure_speed: float = 1.0
    """Speed of the gait to draw in space [m/s]; the nearest of the library is drawn."""

    def __post_init__(self) -> None:
        """Refuse to replace the shipped library by another one.

        Raises:
            ConfigurationError: the settings would do so.
        """
        super().__post_init__()
        usual = Config.speeds, Config.samples, SlipParameters(), Config.objective
        if self.out == Config.out and usual != (
            self.speeds, self.samples, self.model, self.objective
        ):  # fmt: skip
            raise ConfigurationError(
                f"{str(self.out)!r} is the shipped library, made with other settings; give"
                " another file with --out"
            )


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import time

import numpy as np
from tqdm import tqdm

from aslip.base.provenance import made_by
from aslip.library import GaitLibrary
from aslip.rom import Gait, Mode, optimize_gaits
from aslip.show.plots import gait_figure, gait_sheet, save_figure


def main(config: Config) -> None:
    """Build, store, print and draw."""
    pictures = config.pictures or config.out.parent
    start = time.perf_counter()
    with tqdm(total=len(config.speeds), desc="gaits", unit="gait") as bar:

        def progress(index: int, count: int, gait: Gait) -> None:
            bar.set_postfix_str(f"{gait.speed:.3g} m/s, stride {gait.stride:.3f} s")
            bar.update()

        gaits = optimize_gaits(
            config.speeds,
            parameters=config.model,
            objective=config.objective,
            progress=progress,
        )
    solved = time.perf_counter()
    about = made_by(("aslip", "casadi", "pin", "numpy", "scipy"))
    library = GaitLibrary.from_motions(gaits, samples=config.samples, made_by=about)
    tabulated = time.perf_counter()
    config.out.parent.mkdir(parents=True, exist_ok=True)
    library.save(config.out)
    print(gait_table(gaits))
    print(
        f"\n{len(gaits)} gaits in {solved - start:.1f} s, inverse kinematics of"
        f" {len(gaits) * config.samples} poses in {tabulated - solved:.1f} s -> {config.out}"
    )

    nearest = gaits[int(np.abs(library.speeds - config.figure_speed).argmin())]
    save_figure(gait_figure(nearest), pictures / "gait.png")
    save_figure(gait_sheet(gaits), pictures / "gaits.png")
    print(f"pictures: {pictures / 'gait.png'}, {pictures / 'gaits.png'}")


def gait_table(gaits: list[Gait]) -> str:
    """Table of gaits and their certificates; the margin is the smallest to any bound."""
    header = (
        "speed  stride  double  step   height  height  sway   hump  least   cost     KKT    defect"
        "  integ.  margin  iter  time  status\n"
        " m/s     s       s      m    min m   max m   mm     N      N    m2/s3"
        "                     mm             s\n"
    )
    rows = []
    for gait in gaits:
        certificate = gait.certificate
        height, sway = gait.body.position[:, 2], np.ptp(gait.body.position[:, 1]) / 2
        least = gait.leg_force[gait.mode == Mode.LEFT, 0].min()
        rows.append(
            f"{round(gait.speed, 3)!s:>4}  {gait.stride:.4f}  {gait.double_stance:.4f}"
            f"  {gait.step_length:.3f}  {height.min():.4f}  {height.max():.4f}"
            f"  {1e3 * sway:4.1f}  {gait.leg_force.max():5.1f}"
            f"  {least:5.1f}  {gait.cost:7.2f}  {certificate.kkt_residual:.0e}"
            f"  {certificate.max_defect:.0e}  {1e3 * certificate.integration_error:.4f}"
            f"  {min(certificate.margins.values()):6.0e}  {certificate.iterations:4d}"
            f"  {certificate.solve_time:.2f}  {certificate.solver_status}"
        )
    return header + "\n".join(rows)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
