"""What all Python tests share: the binary under test, and offline astropy."""

import os
import pathlib
import subprocess
import sys

import pytest
from astropy.utils import iers

sys.path.insert(0, str(pathlib.Path(__file__).parent))
PROJECT = pathlib.Path(__file__).resolve().parents[2]

# no downloads: the bundled tables must do
iers.conf.auto_download = False
iers.conf.iers_degraded_accuracy = "ignore"

# each runs nights of a minute or more; begun first, they end with the others
LONGEST = ["disk_full", "pixel_types", "delivery_faults", "delivery", "foreign_sky", "parquet", "imported_sites", "import_document", "foreign_actions", "guide",
           "foreign_night", "transit", "profiles"]


def pytest_collection_modifyitems(items):
    """The longest files first; `scripts/foreign` keeps this order."""
    for name in LONGEST:
        assert pathlib.Path(__file__).with_name(f"test_{name}.py").exists(), f"{name} is no file of tests; see LONGEST"

    def place(item) -> int:
        name = item.path.stem.removeprefix("test_")
        return LONGEST.index(name) if name in LONGEST else len(LONGEST)
    items.sort(key=place)


@pytest.fixture(scope="session")
def starmesh() -> str:
    """Path of the starmesh binary."""
    binary = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "debug" / "starmesh"))
    assert binary.exists(), f"{binary} is missing: run `cargo build --workspace` (scripts/test does)"
    return str(binary)


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory) -> pathlib.Path:
    """Invented stars in the format of the Gaia-2MASS files: what alpaca-simulators draw, and what Starmesh may know."""
    file = tmp_path_factory.mktemp("catalogue") / "stars.db"
    script = pathlib.Path(__file__).with_name("make_catalogue.py")
    subprocess.run([sys.executable, str(script), str(file)], check=True, stdout=subprocess.DEVNULL)
    return file
