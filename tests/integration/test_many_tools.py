"""`highside run` with [[tools]]: several tools in one process, real ptys, real brokers; what befalls one is its own."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import Pty, Subscriber, running, wait_for
from test_run import frames

pytestmark = pytest.mark.slow


class Tool:
    """One of them: its line, and what it says at its broker."""

    def __init__(self, name: str, broker: Mosquitto, folder: Path) -> None:
        self.name, self.broker = name, broker
        self.line = Pty()
        # a name of its own: that of a pty which is gone may soon be another program's
        self.port = folder / f"port-{name}"
        self.port.symlink_to(self.line.path)
        self.heard = Subscriber(broker.port, f"highside/{name}/#")
        self.sent = self.unheard = 0

    def table(self, more: str = "") -> str:
        link = f'link = {{ kind = "serial", port = "{self.port}", backoff_max_s = 0.2 }}\n'
        return f'[[tools]]\nid = "{self.name}"\n{link}mqtt = {{ port = {self.broker.port} }}\n{more}'

    def send(self, n: int) -> None:
        self.line.write_all(frames(n, start=self.sent))
        self.sent += n

    def is_open(self) -> bool:
        health = self.heard.latest("health")
        return health is not None and health["link"]["opens"] >= 1

    def took_all(self) -> bool:
        """Every frame was taken, every message acknowledged, and all but what fell in the broker's absence heard."""
        health = self.heard.latest("health")
        return (
            health is not None
            and health["monitor"]["received"] == self.sent
            and health["outbox"]["queued"] == 0
            and len(self.heard.payloads("attitude")) + self.unheard >= health["pipeline"]["attitudes"] > 0
        )

    def has_delivered(self) -> bool:
        """As `took_all`, where the subscriber may have come back to the broker after the tool."""
        health = self.heard.latest("health")
        if health is None or health["monitor"]["received"] != self.sent or health["outbox"]["queued"]:
            return False
        self.unheard = health["pipeline"]["attitudes"] - len(self.heard.payloads("attitude"))
        return True

    def unplug(self) -> None:
        self.port.unlink()
        self.line.close()

    def close(self) -> None:
        self.heard.close()
        if self.port.is_symlink():
            self.unplug()


def common(folder: Path) -> str:
    return f'[codec]\nname = "tool"\n[service]\nstate_dir = "{folder}/state"\nhealth_interval_s = 0.2\n'


@pytest.mark.timeout(180)
def test_a_fault_of_one_tool_never_touches_another(tmp_path: Path) -> None:
    (tmp_path / "state/c").mkdir(parents=True)
    (tmp_path / "state/c/recordings").write_text("in the way")
    with Mosquitto(tmp_path / "one") as one, Mosquitto(tmp_path / "two") as two:
        tools = a, b, c, d = [Tool(name, two if name == "b" else one, tmp_path) for name in "abcd"]
        path = tmp_path / "rig.toml"
        absent = '[[tools]]\nid = "e"\nlink = { kind = "serial", port = "/dev/no-such-port" }\n'
        path.write_text(common(tmp_path) + "".join(tool.table() for tool in (a, b, c)) + absent)
        with running(path) as daemon:
            for tool in (a, b, c):
                wait_for(tool.is_open, 60, f"the link of {tool.name}", daemon)
            assert "e: " in daemon.log  # the port that is not there is named, and the others run
            # the broker of b goes away, and the line of c
            two.kill()
            c.unplug()
            for _ in range(3):
                a.send(100)
                b.send(100)
            wait_for(a.took_all, 30, "all of a", daemon)
            two.start()
            wait_for(b.has_delivered, 60, "all of b after its broker came back", daemon)
            for tool in (a, b):
                assert all(tool.heard.latest("health")["balance"].values())
                assert (tmp_path / f"state/{tool.name}/recordings").is_dir()
            numbers = sorted(p["seq"] for p in a.heard.payloads("attitude"))
            assert numbers == list(range(len(numbers)))
            before = a.heard.latest("health")["link"]["opens"]

            # a spoilt table refuses the reload of its own tool; d is new, c is gone
            path.write_text(common(tmp_path) + a.table() + b.table("pipeline = { output_rate_hz = -1 }\n") + d.table())
            daemon.process.send_signal(signal.SIGHUP)
            wait_for(d.is_open, 30, "the new tool", daemon)
            wait_for(lambda: b.heard.latest("health")["reload"]["refused"], 20, "the refusal of b", daemon)
            assert "tool b" in str(b.heard.latest("health")["reload"])
            for tool in (a, b, d):
                tool.send(100)
            for tool in (a, b, d):
                wait_for(tool.took_all, 30, f"all of {tool.name} after the reload", daemon)
            assert a.heard.latest("health")["reload"]["refused"] is None
            assert a.heard.latest("health")["link"]["opens"] == before
            assert daemon.terminate(20) == 0, daemon.log
            assert "Traceback" not in daemon.log
        for tool in tools:
            statuses = [m[1] for m in tool.heard.drain() if m[0].endswith("/status")]
            assert statuses[-1] == b"offline" or tool is c, (tool.name, statuses)
            tool.close()


def test_where_no_tool_can_be_begun_the_service_ends_with_the_first_reason(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(common(tmp_path) + '[[tools]]\nid = "e"\nlink = { kind = "serial", port = "/dev/no-such-port" }\n')
    with running(path) as daemon:
        assert daemon.process.wait(60) == 2
        assert "no-such-port" in daemon.log.splitlines()[-1]
