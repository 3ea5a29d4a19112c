"""Gaits of a policy: shipped ones, or the copy that a training kept beside its file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aslip.envs import shipped_library
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.library.library import SHIPPED
from aslip.policy.file import POLICY_FILE, find_policy, policy_stack, read_card

LIBRARY_FILE = "library.npz"
"""Name of the copy of the gaits in the folder of a training run."""


def policy_library(
    name_or_path: str | Path, library: GaitLibrary | str | Path | None = None
) -> GaitLibrary:
    """Gaits that a policy follows.

    Args:
        name_or_path: name of a shipped policy, file of a policy, or folder of a training run.
        library: library with these gaits, its file, or the name of a shipped one. By default it is
            the copy beside the policy: `library.npz` in a run folder, `mine.npz` for `mine.zip`;
            without one it is the shipped library of the stack, which for a stack without a name
            follows from the entries of the observation.

    Raises:
        AssetError: there is no such policy or library.
        FileDamagedError: a file is truncated, altered, or of another kind.
        ConfigurationError: the policy follows other gaits than those of the library.
    """
    card = read_card(name_or_path)
    if library is None:
        copy = _library_beside(find_policy(name_or_path))
        library = copy if copy.is_file() else _shipped_library(card)
    if not isinstance(library, GaitLibrary):
        # a shipped one is read once
        read = shipped_library if library in SHIPPED else GaitLibrary.load
        library = read(str(library))
    check_policy_library(name_or_path, card, library)
    return library


def policy_environment(
    name_or_path: str | Path, library: GaitLibrary | str | Path | None = None
) -> dict[str, Any]:
    """Environment of a policy, as arguments `stack` and `library` of `aslip.make_env`.

    Arguments and errors are those of `policy_library`, errors also those of `policy_stack`.
    """
    stack = policy_stack(name_or_path)
    return {"stack": stack, "library": policy_library(name_or_path, library)}


def _library_beside(policy: Path) -> Path:
    """File, which need not exist, of the copy of the gaits that a policy's file follows."""
    if policy.name == POLICY_FILE:
        return policy.with_name(LIBRARY_FILE)
    return policy.with_suffix(".npz")


def keep_library(policy: Path, library: GaitLibrary | None) -> None:
    """Copy the gaits of a policy to where `policy_library` finds them; shipped ones need no copy.

    Args:
        policy: file of the policy, which need not exist yet.
        library: the gaits; None for a policy that follows no library.
    """
    copy = _library_beside(policy)
    if library is None or library.name in SHIPPED:
        copy.unlink(missing_ok=True)
    else:
        library.save(copy)


def _shipped_library(card: Mapping[str, Any]) -> str:
    """Name of the shipped library of a policy's stack."""
    if card["stack"] == "single_reference":
        return "single_reference"
    return "directions" if in_all_directions(card) else "gaits"


def in_all_directions(card: Mapping[str, Any]) -> bool:
    """True for a policy that observes commands of three axes, given ones or those of a plan."""
    return any(name.endswith("filtered_command") for name in card.get("observation", ()))


def check_policy_library(
    name_or_path: str | Path, card: Mapping[str, Any], library: GaitLibrary
) -> None:
    """Check that a policy follows the gaits of a library, if its file names any.

    Args:
        name_or_path: name or path, for the message.
        card: card of the policy, see `read_card`.
        library: the gaits.

    Raises:
        ConfigurationError: it follows others.
    """
    followed = card["library_sha256"]
    if followed is not None and followed != (given := library.sha256):
        trained = card["made_by"].get("settings", {}).get("library")
        of, name = f", those of {trained!r}" if trained else "", library.name
        raise ConfigurationError(
            f"the policy {str(name_or_path)!r} follows other gaits{of}: the SHA-256 of its library"
            f" begins with {followed[:12]}, that of {repr(name) if name else 'the given one'} with"
            f" {given[:12]}; give its own library (programs take --library FILE)"
        )
