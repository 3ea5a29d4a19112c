"""ZIP archives taken apart and put together."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

from aslip.files.archive import SUMS, sums


def unzipped(data: bytes) -> dict[str, bytes]:
    """Entries of an archive."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(parts: Mapping[str, bytes]) -> bytes:
    """An archive of entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def forged(parts: Mapping[str, bytes]) -> bytes:
    """An archive of entries with the hashes that they have now."""
    rest = {name: content for name, content in parts.items() if name != SUMS}
    return zipped({**rest, SUMS: sums(rest)})
