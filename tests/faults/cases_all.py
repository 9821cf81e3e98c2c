"""All cases, in the order in which a short run takes them."""

import cases_age  # noqa: F401
import cases_bus
import cases_closing  # noqa: F401
import cases_devices  # noqa: F401
import cases_inputs  # noqa: F401
import cases_limits  # noqa: F401
import cases_loops  # noqa: F401
import cases_machine  # noqa: F401
import cases_network  # noqa: F401
import cases_policy  # noqa: F401
import cases_readings  # noqa: F401
import cases_signals  # noqa: F401
import cases_slit  # noqa: F401
import cases_start  # noqa: F401
from case import CASES


def attack(times: int):
    """How many bad commands and permits each such case puts on the bus."""
    cases_bus.ATTACKS = times


__all__ = ["CASES", "attack"]
