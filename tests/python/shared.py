"""What the Python tests of this folder and of `tests/foreign` share: the project, the binary under test, and offline astropy."""

import os
import pathlib

import pytest
from astropy.utils import iers

PROJECT = pathlib.Path(__file__).resolve().parents[2]

# no downloads: the bundled tables must do
iers.conf.auto_download = False
iers.conf.iers_degraded_accuracy = "ignore"


@pytest.fixture(scope="session")
def starmesh() -> str:
    """Path of the starmesh binary."""
    binary = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "debug" / "starmesh"))
    assert binary.exists(), f"{binary} is missing: run `cargo build --workspace` (scripts/test does)"
    return str(binary)
