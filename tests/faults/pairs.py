"""For the soak: the same case in another phase, or with a second thing broken beside it."""

import dataclasses
import random
import signal

from case import Case


def kill(node):
    return f"{node} killed", lambda harness: harness.signal(signal.SIGKILL, node)


def stop(node):
    return f"{node} stopped", lambda harness: harness.signal(signal.SIGSTOP, node)


def fault(kind, **words):
    return f"{kind} at fault", lambda harness: harness.wire.fault(kind, **words)


# what must never matter to closing
COMPANIONS = [kill("archive"), kill("web"), stop("archive"), stop("web"), fault("camera", hang=True),
              fault("camera", refuse=True), fault("focuser", html=True), fault("filterwheel", slow_ms=3000)]
PHASES = ["exposing", "slewing", "downloading"]


def paired(case: Case, chance: random.Random) -> Case:
    """Maybe another phase, maybe a companion; the seed decides."""
    more = {}
    if case.phase in PHASES and case.bound and case.flavour == "plain":
        more["phase"] = chance.choice(PHASES)
    if case.bound and chance.random() < 0.25:
        word, spoil = chance.choice(COMPANIONS)
        if case.takes_frames_first and word.startswith("camera"):
            return dataclasses.replace(case, **more)

        def run(harness, scenario=case.run, spoil=spoil):
            spoil(harness)
            harness.mark()
            yield from scenario(harness)
        more.update(run=run, name=f"{case.name}, with {word}")
    return dataclasses.replace(case, **more)
