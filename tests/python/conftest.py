"""Tests that decide: no night, no random draw, and no result that depends on how fast the machine is. Nights are in `tests/foreign`."""

import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent))

from shared import starmesh  # noqa: E402, F401 (a fixture)
