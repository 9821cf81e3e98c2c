"""What Siril makes of the frames of the demo's night, by the steps of its own script for monochrome cameras."""

import os
import pathlib
import re

from demo_night import run

STEPS = """requires 1.0.0
cd bias
convert bias -out=../process
cd ../process
stack bias rej 3 3 -nonorm -out=../master_bias
cd ../dark
convert dark -out=../process
cd ../process
stack dark rej 3 3 -nonorm -out=../master_dark
cd ../flat
convert flat -out=../process
cd ../process
preprocess flat -bias=../master_bias
stack pp_flat rej 3 3 -norm=mul -out=../master_flat
cd ../light
convert light -out=../process
cd ../process
preprocess light -dark=../master_dark -flat=../master_flat -cc=dark
register pp_light
stack r_pp_light rej 3 3 -norm=addscale -out=../result
"""


def result(frames: dict[str, list[pathlib.Path]], folder: pathlib.Path) -> pathlib.Path:
    """The stack of the light frames, calibrated by the other kinds of frames, all of which Siril has converted in this order."""
    for kind, paths in frames.items():
        of_kind = folder / kind.lower()
        of_kind.mkdir()
        for path in paths:
            (of_kind / path.name).symlink_to(path)
    (folder / "steps.ssf").write_text(STEPS)
    said = run("siril-cli", "-d", folder, "-s", folder / "steps.ssf", env=os.environ | {"HOME": str(folder)})
    converted = re.findall(r"Conversion succeeded, .* (\d+) input file\(s\) \((\d+) image\(s\) converted, 0 failed\)", said)
    assert converted == [(str(len(paths)),) * 2 for paths in frames.values()], said
    return folder / "result.fit"
