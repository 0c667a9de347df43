"""Configurations that a reload must refuse: one of every kind of mistake."""

from __future__ import annotations

from pathlib import Path


def bad_files(good: str, device: str, taken_port: int, folder: Path) -> dict[str, str]:
    """Each differs from the good file in one place; `device` is its port, `taken_port` a listener of somebody else.

    The good one has its output rate as `output_rate_hz = N`, the tool "t..." in the first table, and `[service]` behind
    `[mqtt]`.
    """
    (folder / "bad.dbc").write_text('BO_ 1 x: 8 y\n SG_ x : 62|4294967296@1+ (1,0) [0|0] "" z\n')
    (line,) = [line for line in good.splitlines() if line.startswith("output_rate_hz")]

    def rate(value: str) -> str:
        return good.replace(line, f"output_rate_hz = {value}")

    return {
        "wrong type": rate('"ten"'),
        "out of range": rate("-1"),
        "nan": rate("nan"),
        "5,000 digits": rate("1" * 5000),
        "unknown field": good + "[monitor]\nrnge_g = 1\n",
        "unknown table": good + "[moniter]\nrange_g = 1\n",
        "unknown codec": good.replace('name = "tool"', 'name = "toll"'),
        "no TOML": "[[[[" * 1000,
        "nested": "a = " + "[" * 50_000,
        "empty": "",
        "nul": "\0" * 4096,
        "torn": good[: len(good) // 2],
        "another tool": good.replace('id = "t', 'id = "u'),
        "another state": good.replace("/state", "/other"),
        "port away": good.replace(device, "/dev/no-such-port"),
        "port is a directory": good.replace(device, str(folder)),
        "listener taken": good + f"[metrics]\nport = {taken_port}\n",
        "no certificate": good.replace("[service]", "[mqtt.tls]\nca = 'no.pem'\n[service]"),
        "no password file": good.replace("[service]", "username = 'a'\npassword_file = 'no.pw'\n[service]"),
        "codec's file": good.replace('name = "tool"', 'name = "dbc"\ndbc = "bad.dbc"'),
    }
