"""What is proven and decides nothing: nights, other people's hardware and programs, kills at random instants (`scripts/proof foreign`)."""

import pathlib
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.with_name("python"))]

from shared import starmesh  # noqa: E402, F401 (a fixture)

# each runs nights of a minute or more; begun first, they end with the others
LONGEST = ["disk_full", "pixel_types", "delivery_faults", "delivery", "foreign_sky", "parquet", "imported_sites", "import_document", "foreign_actions", "guide",
           "foreign_night", "transit", "tools", "profiles"]


def pytest_collection_modifyitems(items):
    """The longest files first; `scripts/proof foreign` keeps this order."""
    for name in LONGEST:
        assert (HERE / f"test_{name}.py").exists(), f"{name} is no file of tests; see LONGEST"

    def place(item) -> int:
        name = item.path.stem.removeprefix("test_")
        return LONGEST.index(name) if name in LONGEST else len(LONGEST)
    items.sort(key=place)


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory) -> pathlib.Path:
    """Invented stars in the format of the Gaia-2MASS files: what alpaca-simulators draw, and what Starmesh may know."""
    file = tmp_path_factory.mktemp("catalogue") / "stars.db"
    subprocess.run([sys.executable, str(HERE / "make_catalogue.py"), str(file)], check=True, stdout=subprocess.DEVNULL)
    return file
