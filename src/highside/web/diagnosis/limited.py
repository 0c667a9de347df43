"""Starts a command with limits of memory, files and time, below everything else of this machine.

    python -m highside.web.diagnosis.limited SECONDS COMMAND ...

The limits are those of the process and outlast the exec; a system without them (Windows) has the time limit of whoever
started it alone.
"""

from __future__ import annotations

import contextlib
import os
import sys

MEMORY_BYTES = 6 * 1024**3
"""Address space: a recording of 10^7 rows takes 2.5 GB, and libraries reserve more than they use."""
FILE_BYTES = 2 * 1024**3
"""Largest file that is written: that of the largest recording that is read."""
FILES = 256
NICE = 10
"""Behind the page, and behind a service on the same machine."""


def main() -> None:
    """Set the limits and become the command."""
    seconds, command = int(float(sys.argv[1])) + 1, sys.argv[2:]
    with contextlib.suppress(ImportError):
        import resource

        wanted = {
            resource.RLIMIT_AS: MEMORY_BYTES,
            resource.RLIMIT_FSIZE: FILE_BYTES,
            resource.RLIMIT_NOFILE: FILES,
            resource.RLIMIT_CORE: 0,
            # of the processor, whose cores count apart
            resource.RLIMIT_CPU: seconds * (os.cpu_count() or 1),
        }
        for name, value in wanted.items():
            hard = resource.getrlimit(name)[1]
            allowed = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(name, (allowed, allowed))
    if hasattr(os, "nice"):
        os.nice(NICE)
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
