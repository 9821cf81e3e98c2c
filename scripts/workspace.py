"""The crates of this repository, for the scripts next to it."""

import pathlib
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[1]


def crates() -> dict[str, pathlib.Path]:
    """The folder of each crate, by the crate's name."""
    found = {}
    for member in tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["members"]:
        for folder in sorted(ROOT.glob(member)):
            if (folder / "Cargo.toml").exists():
                found[tomllib.loads((folder / "Cargo.toml").read_text())["package"]["name"]] = folder
    return found
