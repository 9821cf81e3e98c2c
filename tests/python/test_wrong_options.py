"""Options of the command line that cannot be are refused with what was expected."""

import subprocess

import pytest


@pytest.mark.parametrize("change, words", [
    (("dec=-45.6779", "dec=-45.5"), "no star is within 5 arcsec of ra=24.3543,dec=-45.5"),
    (("depth-mmag=15,", ""), "depth-mmag is missing; expected ra=DEG,dec=DEG,"),
    (("ingress-min=8", "ingress-min=80"), "ingress-min=80: expected a number from 0 to 25"),
])
def test_a_transit_that_cannot_be_is_refused_with_what_was_expected(starmesh, change, words):
    written = "ra=24.3543,dec=-45.6779,depth-mmag=15,mid=2026-11-22T01:20:00Z,duration-min=50,ingress-min=8"
    command = [starmesh, "simulator", "--bind", "127.0.0.1:0", "--transit", written.replace(*change)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0 and words in done.stderr, done.stderr
