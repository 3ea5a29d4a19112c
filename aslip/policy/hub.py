"""Policies on the Hugging Face hub: a policy file and its card in a repository.

`load_policy("hf://owner/name")` and all programs with `--policy` take one;
`python -m recipes.policy_card --hub owner/name` uploads one.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from aslip.base.imports import extras
from aslip.errors import AssetError

HUB = "hf://"
"""Beginning of the name of a policy on the hub."""

_FRONT_MATTER = """\
---
library_name: aslip
pipeline_tag: reinforcement-learning
tags:
- robotics
- legged-locomotion
- cassie
- mujoco
- torchrl
---
"""


@functools.cache
def hub_file(name: str, file: str) -> Path:
    """File of a repository, downloaded unless the hub's cache on this machine has it.

    A process uses what it first got, also if the repository changes.

    Args:
        name: "hf://owner/name", or "hf://owner/name@revision" with a branch, tag or commit.
        file: its name in the repository.

    Raises:
        AssetError: there is no such file, or the hub cannot be reached.
        MissingExtraError: the library of the hub is not installed.
    """
    repository, _, revision = name.removeprefix(HUB).partition("@")
    with _hub(name):
        from huggingface_hub import hf_hub_download

        return Path(
            hf_hub_download(repository, file, revision=revision or None, library_name="aslip")
        )


def upload(name: str, card: str, files: Mapping[str, bytes]) -> str:
    """Upload files and their card in one commit; returns its address.

    A new repository is private. The card gets the front matter by which the hub finds it, and how
    to load the policy.

    Args:
        name: "owner/name" of the repository.
        card: text of the card.
        files: name -> content.

    Raises:
        AssetError: the hub refuses it, or cannot be reached.
        MissingExtraError: the library of the hub is not installed.
    """
    name = name.removeprefix(HUB)
    usage = f'policy = aslip.load_policy("{HUB}{name}")'
    text = f"{_FRONT_MATTER}\n{card.strip()}\n\n## Use\n\n```python\nimport aslip\n\n{usage}\n```\n"
    with _hub(name):
        from huggingface_hub import CommitOperationAdd, HfApi

        api = HfApi(library_name="aslip")
        api.create_repo(name, private=True, exist_ok=True)
        contents = {**files, "README.md": text.encode()}
        added = [CommitOperationAdd(file, content) for file, content in contents.items()]
        return str(api.create_commit(name, added, commit_message="Policy and card").commit_url)


@contextmanager
def _hub(name: str) -> Iterator[None]:
    """Raise errors of the hub as AssetError."""
    try:
        with extras():
            yield
    except Exception as error:
        # the library and its HTTP client have errors of many kinds
        if not type(error).__module__.startswith(("huggingface_hub", "httpx", "httpcore")):
            raise
        reason = " ".join(str(error).split())[:300]
        raise AssetError(f"{name!r} on the Hugging Face hub: {reason}") from error
