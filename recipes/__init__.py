"""Programs of a page each; they import one another by name, as scripts do."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
