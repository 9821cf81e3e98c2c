"""The guide to a first night, literally: every command is typed as it is printed, and the terminals show what is printed."""

import pathlib
import shutil
import subprocess
import sys

import guide
import pytest
from shared import PROJECT

DOCUMENT = PROJECT / "docs/operator/first-night.md"


@pytest.mark.parametrize("pause_s", [0, 120])
def test_the_guide_leads_from_an_empty_directory_through_a_night_with_rain(starmesh, tmp_path, pause_s):
    """Typed at once, and by somebody who needs two minutes for each command."""
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    script = pathlib.Path(guide.__file__)
    done = subprocess.run(["unshare", "--net", sys.executable, "-B", str(script), starmesh, str(DOCUMENT), str(tmp_path), str(pause_s)],
                          capture_output=True, text=True, timeout=5400)
    if done.returncode != 0:
        pytest.fail(f"{done.stderr}\n{done.stdout[-20000:]}")


def test_a_line_of_the_guide_matches_any_width_of_blanks_and_anything_for_dots():
    shown = "TELESCOPE    SAFETY  NOW\na/b          SAFE    OPENING  x\nc/d          SAFE    OPEN   x60   takes frames\n"
    assert guide.missing(["TELESCOPE SAFETY NOW", "c/d SAFE OPEN x60 ..."], shown) is None
    assert guide.missing(["c/d SAFE OPEN x60 ...", "TELESCOPE SAFETY NOW"], shown) == "TELESCOPE SAFETY NOW"
    assert guide.missing(["a/b SAFE OPEN ..."], shown) is not None
    assert guide.missing(["... OPEN x60"], shown) is not None
