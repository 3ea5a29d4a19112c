"""Formats of the protocol in `struct`'s notation, and random packets."""

from __future__ import annotations

import numpy as np

from aslip.network.wire import Packet

_LEG = "H7f" * 5 + "6fBH?"
FORMATS = {
    "pd_in_t": "<119f",
    "cassie_user_in_t": "<10f9h",
    "state_out_t": "<121f?2f",
    "cassie_out_t": f"<6i21ifIf?f12ff4f??16f?Hff3f3f3f4fBH???f{_LEG}{_LEG}?4h",
}
"""Payloads of the public C code."""


def random_bytes(packet: Packet, num: int, rng: np.random.Generator) -> np.ndarray:
    """Random payloads (num, size): any bits, NaN and infinities among them; flags are 0 or 1."""
    raw = rng.integers(256, size=(num, packet.size), dtype=np.uint8)
    for place in packet.places:
        if place.kind == "?":
            raw[:, place.offset] &= 1
    return raw
