"""Our plate solver on frames whose place astropy knows: asked with a hint and without one."""

from drawn_sky import apart_px, drawn, ours  # noqa: F401 (a fixture)


def test_starmesh_agrees_with_the_wcs_that_astropy_drew(starmesh, drawn):  # noqa: F811
    for frame, truth in drawn:
        ra, dec = truth.wcs.crval
        place = [f"--ra-deg={ra}", f"--dec-deg={dec - 0.7}", "--scale-arcsec-px=8.1"]
        hinted, blind = ours(starmesh, frame, *place), ours(starmesh, frame, "--scale-arcsec-px=8.1")
        figures = apart_px(truth, hinted), apart_px(truth, blind)
        print(f"{frame.name}: Starmesh with a hint {figures[0]:.3f} px off, without {figures[1]:.3f} px (worst corner)")
        assert max(figures) < 0.2, frame
