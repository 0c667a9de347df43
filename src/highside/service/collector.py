"""Python's garbage collector in a process that must answer within milliseconds.

A full collection looks at every container of the process. What the start has made (modules, models of the
configuration) are 70,000 of them, none of which will ever be garbage: such a look held the event loop for 45 to 90 ms,
and was the longest stall of all. After `keep_what_the_start_made` only what is made from then on is looked at.
"""

from __future__ import annotations

import gc


def keep_what_the_start_made() -> None:
    """Collect once, and never look at what is left again. To be called once a process, when all is imported and built:
    rings of references in it, such as the parts that the first reload replaces, are kept for good."""
    gc.collect()
    gc.freeze()
