"""The table at the end: per class of fault, how many, how many closed, how fast, and what of the night was left."""

import collections
import math
import statistics

from case import Result

# what a fault costs is counted against a night of 8 h and the default dwell of 15 min, of which a run here has 3 s
NIGHT_S, DWELL_S, DWELL_HERE_S = 8 * 3600.0, 900.0, 3.0


def p99(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, math.ceil(0.99 * len(ordered)) - 1)]


def rows(results: list[Result], allowance_s: float) -> list[str]:
    groups: dict[str, list[Result]] = collections.defaultdict(list)
    for result in results:
        groups[result.case.group].append(result)
    busy = f" + {allowance_s:g} for a busy machine" if allowance_s else ""
    lines = ["| class of fault | injected | ended as they must | verified closed | first request, s: median, p99, slowest "
             "| bound, s | night went on by itself |", "|---|--:|--:|--:|--:|--:|--:|"]
    for group, members in groups.items():
        must_close = [r for r in members if r.case.bound]
        took = [r.took_s for r in must_close if r.took_s is not None]
        speed = f"{statistics.median(took):.2f}, {p99(took):.2f}, {max(took):.2f}" if took else "-"
        bound = must_close[0].case.bound if must_close else None
        limit = "none need close" if bound is None else f"{bound.max_s:g}{busy}" + (
            f"; p99 {bound.p99_s:g}" if bound.p99_s else "")
        closed = f"{sum(r.closed for r in must_close)} of {len(must_close)}" if must_close else (
            f"{sum(r.closed for r in members)} closed for a while")
        wanted = [r for r in members if r.case.goes_on]
        went_on = f"{sum(bool(r.went_on) for r in wanted)} of {len(wanted)}"
        passed = sum(r.passed for r in members)
        lines.append(f"| {group} | {len(members)} | {passed} | {closed} | {speed} | {limit} | {went_on} |")
    total = len(results)
    must_close = [r for r in results if r.case.bound]
    lines.append(f"| **all** | {total} | {sum(r.passed for r in results)} | {sum(r.closed for r in must_close)} of "
                 f"{len(must_close)} | | | {sum(bool(r.went_on) for r in results if r.case.goes_on)} of "
                 f"{sum(r.case.goes_on for r in results)} |")
    return lines


def dark_time(results: list[Result]) -> str:
    """Share of the remaining night that is used after a fault that heals."""
    shares = []
    for result in results:
        if result.case.goes_on:
            cost = NIGHT_S if not result.went_on else result.lost_s
            if result.went_on and result.closed:
                cost += DWELL_S - DWELL_HERE_S
            shares.append(1.0 - cost / NIGHT_S)
    if not shares:
        return "no fault of this run is one that heals"
    return (f"remaining dark time used after a fault that heals: mean {100 * statistics.mean(shares):.1f} %, worst "
            f"{100 * min(shares):.1f} % (of an 8 h night, with the default dwell of 15 min in place of the 3 s here)")


def is_late(result: Result, allowance_s: float) -> bool:
    """Beyond the time that 99 in 100 of its class must keep, which a single one need not."""
    limit_s = result.case.bound and result.case.bound.p99_s
    return bool(limit_s) and result.took_s is not None and result.took_s > limit_s + allowance_s


def late_s(result: Result) -> float:
    """How long after its bound the first request came."""
    return max(0.0, result.took_s - result.case.bound.max_s) if result.case.bound and result.took_s is not None else 0.0


def p99_over_all(results: list[Result], allowance_s: float) -> tuple[str, bool]:
    """The classes with a p99 together; and whether at most 1 in 100 is late. Of a few dozens one may be."""
    bounded = [r for r in results if r.case.bound and r.case.bound.p99_s and r.took_s is not None]
    if not bounded:
        return "no class of this run has a p99", True
    late, may_be = sum(is_late(r, allowance_s) for r in bounded), max(1, len(bounded) // 100)
    found, limit_s = p99([r.took_s for r in bounded]), min(r.case.bound.p99_s for r in bounded) + allowance_s
    return (f"p99 to the first request over the {len(bounded)} injections of classes with a p99: {found:.2f} s, "
            f"bound {limit_s:g} s; {late} beyond it, {may_be} may be", late <= may_be)


def hazards(results: list[Result]) -> str:
    covered = sorted({hazard for r in results for hazard in r.case.hazards}, key=lambda h: (h[0], int(h[1:])))
    return "hazards met at least once: " + " ".join(covered)
