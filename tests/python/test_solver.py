"""Our plate solver on frames whose place astropy knows: each with a hint, and a mirrored one without; all without in `test_solvers_agree.py`."""

from drawn_sky import apart_px, drawn, ours  # noqa: F401 (a fixture)


def test_starmesh_agrees_with_the_wcs_that_astropy_drew(starmesh, drawn):  # noqa: F811
    for frame, truth in drawn:
        ra, dec = truth.wcs.crval
        hint = [f"--ra-deg={ra}", f"--dec-deg={dec - 0.7}", "--scale-arcsec-px=8.1"]
        for options in [hint, hint[-1:]] if frame is drawn[1][0] else [hint]:
            apart = apart_px(truth, ours(starmesh, frame, *options))
            print(f"{frame.name}, {options}: {apart:.3f} px off (worst corner)")
            assert apart < 0.2, (frame, options)
