"""Places of the reduced-order model in pictures that move: film, viewer, live page."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

RomPlace = Literal["beside", "through", "hidden"]
ROM_PLACES: tuple[RomPlace, ...] = get_args(RomPlace)
"""Places of the reduced-order model: beside the robot, in its place, or hidden."""

BESIDE = np.array([0.0, -0.7, 0.0])
"""Offset of the reduced-order model beside a robot that walks ahead [m]: to the right."""
BESIDE_STEPS = np.array([0.0, -0.85, 0.0])
"""Offset beside robots that sidestep, whose feet take more room [m]."""
