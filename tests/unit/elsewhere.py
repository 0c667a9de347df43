"""Runs `highside` as on a system that has nothing of POSIX but Python: what Windows lacks is hidden from our modules.

Python's own library and the packages beside it come for each system; ours have to do without. Hidden from modules of
`highside` alone are the modules, the attributes and the kinds of sockets that Windows does not have. Files behave as
there: one that is open (by anybody in this process) is neither replaced, renamed nor deleted, a directory cannot be
opened, and renaming does not replace.

Run as a program it takes a JSON list of the arguments of `highside`, one list a job, on its standard input.
"""

from __future__ import annotations

import asyncio
import builtins
import importlib
import json
import os
import select
import signal
import socket
import sys
import time
import types
from pathlib import Path
from typing import Any

MODULES = {"fcntl", "termios", "tty", "pty", "pwd", "grp", "resource", "syslog", "crypt", "readline", "posix"}
ATTRIBUTES: dict[types.ModuleType, set[str]] = {
    os: {
        "chown", "fchmod", "fchown", "fdatasync", "fork", "forkpty", "getegid", "geteuid", "getgid", "getgroups",
        "getloadavg", "getpgid", "getpgrp", "getpriority", "getresuid", "getsid", "getuid", "killpg", "lchown",
        "mkfifo", "mknod", "nice", "openpty", "pathconf", "posix_fadvise", "posix_fallocate", "posix_spawn", "pread",
        "preadv", "pwrite", "pwritev", "sched_getaffinity", "sched_setaffinity", "sched_yield", "sendfile",
        "set_blocking", "setegid", "seteuid", "setgid", "setpgid", "setsid", "setuid", "statvfs", "sync", "sysconf",
        "tcgetpgrp", "ttyname", "uname", "wait3", "wait4", "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW",
        "O_NONBLOCK", "O_SYNC", "O_DSYNC", "O_PATH", "O_TMPFILE", "WNOHANG", "ST_NOEXEC",
    },
    signal: {"SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGKILL", "SIGQUIT", "SIGWINCH", "SIGCHLD", "SIGPIPE",
             "alarm", "setitimer", "pthread_sigmask", "sigwait", "pause"},
    socket: {"AF_UNIX", "AF_CAN", "AF_NETLINK", "SO_REUSEPORT", "SO_PEERCRED", "SOCK_CLOEXEC", "CAN_RAW"},
    select: {"poll", "epoll"},
    time: {"clock_gettime", "clock_gettime_ns", "CLOCK_BOOTTIME", "CLOCK_MONOTONIC", "tzset", "pthread_getcpuclockid"},
}  # fmt: skip


class Without(types.ModuleType):
    """A module as it is, but for what is hidden."""

    def __init__(self, real: types.ModuleType, hidden: set[str]) -> None:
        super().__init__(real.__name__)
        self.__dict__["_real"], self.__dict__["_hidden"] = real, hidden

    def __getattr__(self, name: str) -> Any:
        if name in self.__dict__["_hidden"]:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return getattr(self.__dict__["_real"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.__dict__["_real"], name, value)


def ours(name: object) -> bool:
    return isinstance(name, str) and (name == "highside" or name.startswith("highside."))


def hide() -> None:
    """From now on modules of `highside` that are imported find themselves on such a system."""
    assert not any(ours(name) for name in sys.modules), "nothing of highside may be loaded before"
    shown = {real.__name__: Without(real, hidden) for real, hidden in ATTRIBUTES.items()}
    shown["os"].__dict__["open"] = open_but_directories
    shown["sys"] = Without(sys, set())
    shown["sys"].__dict__["platform"] = "win32"
    load = builtins.__import__

    def find(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:  # noqa: A002
        if level == 0 and globals is not None and ours(globals.get("__name__")):
            if name.partition(".")[0] in MODULES:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            if name in shown:
                return shown[name]
        return load(name, globals, locals, fromlist, level)

    builtins.__import__ = find
    asyncio.WindowsSelectorEventLoopPolicy = asyncio.DefaultEventLoopPolicy  # type: ignore[attr-defined]
    asyncio.AbstractEventLoop.add_signal_handler = refused  # type: ignore[method-assign, assignment]
    asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler = refused  # type: ignore[attr-defined]
    for name in ("replace", "rename", "unlink"):
        setattr(Path, name, unless_open(getattr(Path, name), replaces=name == "replace", takes=name != "unlink"))


def refused(*_: object) -> None:
    """What Windows' event loop answers to whoever would give it a signal handler."""
    raise NotImplementedError


def called_by_us(depth: int) -> bool:
    return ours(sys._getframe(depth).f_globals.get("__name__"))


def open_but_directories(path: Any, *arguments: Any, **named: Any) -> int:
    if not isinstance(path, int) and os.path.isdir(path):  # noqa: PTH112
        raise PermissionError(13, "Permission denied", str(path))
    return os.open(path, *arguments, **named)


def unless_open(real: Any, *, replaces: bool, takes: bool) -> Any:
    """A method of Path that moves or deletes files, with the manners of Windows."""

    def method(self: Path, *arguments: Any, **named: Any) -> Any:
        if called_by_us(2):
            for path in (self, *(Path(place) for place in arguments[:1] if takes)):
                if is_open(path):
                    raise PermissionError(13, "The process cannot access the file", str(path))
            if takes and not replaces and Path(arguments[0]).exists():
                raise FileExistsError(17, "File exists", str(arguments[0]))
        return real(self, *arguments, **named)

    return method


def is_open(path: Path) -> bool:
    """Whether this process has a regular file open."""
    try:
        meant = path.stat()
    except OSError:
        return False
    for descriptor in os.listdir("/proc/self/fd"):  # noqa: PTH208
        try:
            here = os.fstat(int(descriptor))
        except OSError:
            continue
        if (here.st_dev, here.st_ino) == (meant.st_dev, meant.st_ino):
            return True
    return False


def run_all(jobs: list[list[str]]) -> int:
    """Each job as `highside` runs it, up to the first that fails; its exit status."""
    from highside.cli.main import main

    for job in jobs:
        sys.argv, began = ["highside", *job], time.monotonic()
        try:
            main()
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else 1
        print(
            f"== exit status {status}: highside {' '.join(job)} ({time.monotonic() - began:.1f} s)",
            file=sys.stderr,
            flush=True,
        )
        if status != 0:
            return status
    return 0


if __name__ == "__main__":
    hide()
    # the one beside this file, under the name by which it is looked for
    sys.modules["msvcrt"] = importlib.import_module("fake_msvcrt")
    sys.exit(run_all(json.loads(sys.stdin.read())))
