"""A transit in a simulated night of real processes: the light curve of the night's report shows it. `tests/bench/transit.py` compares it with prose's."""

import subprocess

import pytest
from transit_night import DEPTH, Fit, Transit, points


@pytest.fixture(scope="module")
def night(starmesh, tmp_path_factory):
    """The light curve, and the exit codes of nodes and simulator."""
    transit = Transit(starmesh, tmp_path_factory.mktemp("transit"))
    try:
        transit.run()
        curve = transit.curve()
    finally:
        codes = transit.stop()
    return curve, codes


def test_the_light_curve_has_the_depth_of_the_transit(night):
    curve, codes = night
    fit = Fit(points(curve))
    print(f"{len(curve['points'])} points, {fit}")
    assert min(fit.inside, fit.outside) >= 10, fit
    assert fit.depth_error < 0.002 and abs(fit.depth - DEPTH) < 3.5 * fit.depth_error, fit
    assert codes == [0, 0]


def test_the_points_scatter_as_their_errors_have_it(night):
    curve, _ = night
    fit = Fit(points(curve))
    error = sum(point["flux_error"] for point in curve["points"]) / len(curve["points"])
    # of as few as ten points the scatter itself is known to a quarter
    assert 0.6 < fit.scatter / error < 1.6, (fit, error)
    assert curve["comparison_stars"] >= 5 and curve["warnings"] == [], curve


@pytest.mark.parametrize("change, words", [
    (("dec=-45.6779", "dec=-45.5"), "no star is within 5 arcsec of ra=24.3543,dec=-45.5"),
    (("depth-mmag=15,", ""), "depth-mmag is missing; expected ra=DEG,dec=DEG,"),
    (("ingress-min=8", "ingress-min=80"), "ingress-min=80: expected a number from 0 to 25"),
])
def test_a_transit_that_cannot_be_is_refused_with_what_was_expected(starmesh, change, words):
    written = "ra=24.3543,dec=-45.6779,depth-mmag=15,mid=2026-11-22T01:20:00Z,duration-min=50,ingress-min=8"
    command = [starmesh, "simulator", "--bind", "127.0.0.1:0", "--transit", written.replace(*change)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode != 0 and words in done.stderr, done.stderr
