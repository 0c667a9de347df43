"""Imported first by the process of which the workers of a fleet are copies: what it and they can do without.

While it imports, nothing is garbage, and no search for some is begun; each copy takes what is there out of its own
searches, and so writes to less of it. At its end nothing has to be freed: it has no file open but its own pipes, and
the kernel takes the memory back at once, where modules are freed one by one in 0.1 to 0.2 s. In any other process
nothing happens.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys

__all__: list[str] = []


def _in_copy() -> None:
    """What the process of all copies has imported is no garbage here either; what is made from now on may be."""
    gc.freeze()
    gc.enable()


if any("multiprocessing.forkserver" in one for one in sys.orig_argv):
    gc.disable()
    os.register_at_fork(after_in_child=_in_copy)
    # copies end by `os._exit` of multiprocessing anyhow
    atexit.register(os._exit, 0)
