"""Folder of the programs that train, walk and measure; after this import Python finds them.

In a checkout and from a wheel alike, `from recipes import ppo_aslip` and `from benchmarks.paper
import step_frequency` are those of this `aslip`, whatever other packages bring under these names.
"""

import sys
from pathlib import Path
from typing import Final

_PACKAGE = Path(__file__).parent
_INSTALLED = _PACKAGE / "_programs"
# a wheel has the programs inside the package, a checkout beside it
PROGRAMS: Final = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parent
"""Folder of `recipes` and `benchmarks`."""

if str(PROGRAMS) not in sys.path[:1]:
    sys.path.insert(0, str(PROGRAMS))
