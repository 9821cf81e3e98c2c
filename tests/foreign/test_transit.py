"""A transit in a simulated night of real processes: the light curve of the night's report shows it. `tests/bench/transit.py` compares it with prose's."""

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
