"""The network: cut, one way only, lossy, late, healed; nodes in namespaces, explicit endpoints, no multicast."""

import time

from case import HANDS, SILENCE, Bound, case

NET = {"flavour": "network"}
LATE = Bound("2 s of delay each way, and IsSafe says false", 12.0)
LOSS = Bound("30 % of the packets lost, and IsSafe says false", 12.0)


def ruled(inward: str, outward: str):
    def run(harness):
        harness.rules(inward, outward)
        harness.mark()
        yield
        harness.rules()
    return run


case("observatory cut off", "N6", SILENCE, **NET)(ruled("drop", "drop"))
case("observatory hears and is not heard", "N6", SILENCE, **NET)(ruled("accept", "drop"))
case("observatory is heard and does not hear", "N6 S2", SILENCE, **NET)(ruled("drop", "accept"))
case("observatory's connections are reset", "N6", SILENCE, short=False, **NET)(
    ruled("meta l4proto tcp reject with tcp reset", "meta l4proto tcp reject with tcp reset"))


def unplugged(*nodes: str):
    def run(harness):
        for node in nodes:
            harness.cable(node, "down")
        harness.mark()
        yield
        for node in nodes:
            harness.cable(node, "up")
    return run


case("observatory's cable pulled", "N6", SILENCE, **NET)(unplugged("observatory"))
case("other device node's cable pulled", "N6 S2", HANDS, **NET)(unplugged("hands"))
case("archive's cable pulled", "N9 S10", group="archive or web dead: nothing closes", watch_s=18.0,
     **NET)(unplugged("archive"))
case("web's cable pulled", "N10 S10", group="archive or web dead: nothing closes", watch_s=18.0,
     **NET)(unplugged("web"))
# four links of the dome's node end at once: none of them may stop what the observatory sends
case("archive's and web's cables pulled", "N9 N10 S10", group="archive or web dead: nothing closes", watch_s=25.0,
     **NET)(unplugged("archive", "web"))


@case("30 % of the packets lost both ways, then it is unsafe", "N7", LOSS, **NET)
def loss(harness):
    drop = "numgen random mod 100 < 30 drop"
    harness.rules(drop, drop)
    time.sleep(2.0)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield
    harness.rules()


@case("2 s of delay each way, then it is unsafe", "N7", LATE, **NET)
def late(harness):
    harness.delay(2.0)
    time.sleep(4.0)
    harness.mark()
    harness.wire.change("safety", unsafe=True)
    yield
    harness.delay(0.0)


@case("2 s of delay each way under a safe sky", "N7", group="slow network under a safe sky", may_close=True,
      watch_s=10.0, short=False, **NET)
def late_and_safe(harness):
    harness.delay(2.0)
    yield
    harness.delay(0.0)
