"""Walks of a policy: recording, evaluation, interactive control (`walker`), metrics.

`metrics` are pure functions of arrays; `tables` writes Markdown.
"""

from aslip.base.imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
