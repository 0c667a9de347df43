"""The interpreter's settings in a process whose event loop must answer within milliseconds.

A full collection looks at every container of the process. What the start has made (modules, models of the
configuration) are 70,000 of them, none of which will ever be garbage: such a look held the event loop for 45 to 90 ms,
and was the longest stall of all. Only what is made later is looked at.

Of threads that compute, each keeps the interpreter for 5 ms by default, and the loop requests it anew after every wait:
beside a thread that reads a CAN adapter it was held for tens of milliseconds.
"""

from __future__ import annotations

import gc
import sys

SWITCH_S = 0.0005
"""How long a thread keeps the interpreter while another waits for it: a turn of the loop is 0.1 to 1 ms."""


def settle_interpreter() -> None:
    """To be called once a process, when all is imported and built: rings of references among what there is now, such as
    the parts that the first reload replaces, are kept for good."""
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
