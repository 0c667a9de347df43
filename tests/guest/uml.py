"""Runs a command in a User Mode Linux guest: a real Linux kernel as an ordinary process of this user.

Why: SocketCAN, interfaces that come and go, and a unit under systemd need a kernel with CAN and root rights, which a
build machine seldom grants. The guest has both and costs a few seconds; neither KVM, root nor a network is needed.
Its root is the host's (so the interpreter and the project are there already), read-only below a layer of guest memory:
nothing the command writes survives, except below the directories named `writable`.

By hand: `python tests/guest/uml.py [--systemd] [--memory 1024M] [--timeout S] COMMAND...`
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCRIPTS = ("init.sh", "systemd.sh", "command.sh")
NEEDED_COMMANDS = ("insmod", "modprobe", "ip", "mount", "chroot", "switch_root", "timeout")
NOT_CARRIED = ("PWD", "OLDPWD", "SHLVL", "XDG_RUNTIME_DIR", "DBUS_SESSION_BUS_ADDRESS", "NOTIFY_SOCKET", "container")
SBIN = ("/usr/sbin", "/sbin")


@dataclass(frozen=True, slots=True)
class Kernel:
    """A User Mode Linux kernel and its module tree."""

    image: Path
    modules: Path


@dataclass(frozen=True, slots=True)
class GuestResult:
    """What came of a command. `status` 124: out of time in the guest; None: the guest did not get to the end."""

    status: int | None
    stdout: str
    stderr: str
    console: str
    boot_s: float | None
    total_s: float


def find_kernel() -> Kernel | None:
    """The installed package user-mode-linux, else one unpacked (`dpkg-deb -x`) below $UML_DIR."""
    roots = [Path("/")]
    if os.environ.get("UML_DIR"):
        roots.append(Path(os.environ["UML_DIR"]))
    for root in roots:
        image = root / "usr/bin/linux.uml"
        modules = sorted((root / "usr/lib/uml/modules").glob("*/kernel"))
        if os.access(image, os.X_OK) and modules:
            return Kernel(image.resolve(), modules[-1].parent.resolve())
    return None


def why_not(*, systemd: bool = False) -> str | None:
    """What is missing for a guest on this machine, or None if it can be run."""
    if find_kernel() is None:
        return "the package user-mode-linux is not installed (nor unpacked below $UML_DIR)"
    search = os.pathsep.join([os.environ.get("PATH", ""), *SBIN])
    missing = [name for name in NEEDED_COMMANDS if shutil.which(name, path=search) is None]
    if _has_wide_registers() and shutil.which("gcc") is None:
        missing.append("gcc")
    if systemd and not Path("/lib/systemd/systemd").exists():
        missing.append("systemd")
    return f"not installed: {', '.join(missing)} (see .ci/packages)" if missing else None


def run_in_guest(
    command: Sequence[str],
    *,
    cwd: Path,
    timeout_s: float,
    env: Mapping[str, str] | None = None,
    writable: Sequence[Path] = (),
    memory: str = "1024M",
    systemd: bool = False,
) -> GuestResult:
    """Boot a guest with `vcan0` up, run `command` in `cwd`, switch it off.

    `env`: additions to this process's environment. `timeout_s` is the command's; the guest gets 60 s more to boot and
    to end. `systemd`: boot systemd first and run the command as one of its services. Raises RuntimeError where a guest
    cannot be run (`why_not`).
    """
    reason = why_not(systemd=systemd)
    kernel = find_kernel()
    if reason is not None or kernel is None:
        raise RuntimeError(reason)
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="highside-guest-") as name:
        run = Path(name).resolve()
        run.chmod(0o755)
        for script in SCRIPTS:
            shutil.copy(HERE / script, run)
            (run / script).chmod(0o755)
        (run / "settings.sh").write_text(
            f"WORK_DIR={shlex.quote(str(cwd))}\nTIMEOUT_S={timeout_s:g}\nSYSTEMD={'yes' if systemd else ''}\n"
            f"NEWER_SYSTEMD={shlex.quote(os.environ.get('HIGHSIDE_GUEST_SYSTEMD', ''))}\n"
            f"WRITABLE={shlex.quote(' '.join(str(place.resolve()) for place in writable))}\n"
        )
        environment = {key: value for key, value in os.environ.items() if key not in NOT_CARRIED} | dict(env or {})
        lines = [f"export {key}={shlex.quote(value)}" for key, value in environment.items() if key.isidentifier()]
        lines.append(f"COMMAND=({shlex.join(command)})")
        (run / "environment.sh").write_text("\n".join(lines) + "\n")
        _boot(kernel, run, memory=memory, systemd=systemd, timeout_s=timeout_s + 60)
        status = _read(run / "status").strip()
        boot_s = _read(run / "boot_s").strip()
        return GuestResult(
            status=int(status) if status else None,
            stdout=_read(run / "stdout"),
            stderr=_read(run / "stderr"),
            console=_read(run / "console"),
            boot_s=float(boot_s) if boot_s else None,
            total_s=time.monotonic() - begin,
        )


def _boot(kernel: Kernel, run: Path, *, memory: str, systemd: bool, timeout_s: float) -> None:
    """Run the kernel until it switches itself off or time is out."""
    arguments = [
        str(kernel.image), f"mem={memory}", "root=none", "rootfstype=hostfs", "rootflags=/", "ro",
        "quiet", "loglevel=4", f"init={run}/init.sh", "con=null", "con0=null,fd:1", "ssl=null",
        f"umid={run.name}", f"uml_dir={run}/", f"GUEST_RUN={run}", f"GUEST_MODULES={kernel.modules}",
    ]  # fmt: skip
    if systemd:
        arguments += ["systemd.unit=guest.target", "systemd.default_device_timeout_sec=1", "systemd.show_status=1"]
    environment = os.environ | {"TMPDIR": str(_memory_directory(memory, run))} | _wide_registers(run)
    with (run / "console").open("wb") as console:
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=console, stderr=console, env=environment, start_new_session=True
        )
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout_s)
        finally:
            # the guest's processes are processes of this group: all end with it, however the kernel ended
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _has_wide_registers() -> bool:
    return "amx_tile" in _read(Path("/proc/cpuinfo"))


def _wide_registers(run: Path) -> dict[str, str]:
    """What the kernel needs in its environment on a processor with AMX (see `wide_registers.c`)."""
    if not _has_wide_registers():
        return {}
    library = run / "wide_registers.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O2", "-o", library, HERE / "wide_registers.c"], check=True)
    return {"LD_PRELOAD": str(library)}


def _memory_directory(memory: str, fallback: Path) -> Path:
    """Where the file behind the guest's memory can lie: room enough, and code may run from it."""
    size = int(memory.rstrip("MG")) * (1 << (30 if memory.endswith("G") else 20))
    shm = Path("/dev/shm")
    if shm.is_dir():
        state = os.statvfs(shm)
        if not state.f_flag & os.ST_NOEXEC and state.f_bavail * state.f_frsize > size and os.access(shm, os.W_OK):
            return shm
    return fallback


def _read(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def main() -> int:
    """Run the command of the command line in a guest and pass on its output and exit status."""
    parser = argparse.ArgumentParser(description="Run a command in a User Mode Linux guest.")
    parser.add_argument("--systemd", action="store_true", help="systemd is the guest's first process")
    parser.add_argument("--memory", default="1024M")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds for the command")
    parser.add_argument(
        "--writable", type=Path, action="append", default=[], help="directory written through to the host"
    )
    parser.add_argument("command", nargs="+")
    options = parser.parse_args()
    result = run_in_guest(
        options.command,
        cwd=Path.cwd(),
        timeout_s=options.timeout,
        writable=options.writable,
        memory=options.memory,
        systemd=options.systemd,
    )
    sys.stdout.write(result.stdout)
    sys.stderr.write(result.stderr)
    if result.status is None:
        sys.stderr.write(f"the guest did not come to the end; its console:\n{result.console}\n")
    sys.stderr.write(f"guest: status {result.status}, up after {result.boot_s} s, {result.total_s:.1f} s in all\n")
    return 125 if result.status is None else result.status


if __name__ == "__main__":
    sys.exit(main())
