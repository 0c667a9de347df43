"""What a message costs mosquitto: processor time and memory, by the number of connections and of subscribers.

    python -m tests.bench.broker_cost [--clients 50] [--messages 20000]

Clients publish attitudes of 353 bytes with QoS 1, as the service does (64 in flight each); subscribers take all of them
with QoS 1. Processor time is that of the broker's process alone, by the scheduler's account, a message in. The last
lines are of a broker whose messages come over the bridges of others (`config/mosquitto-bridge.conf`), each with the
tools of a site.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt

from tests.integration.broker import Mosquitto, free_port

PAYLOAD = b"x" * 353
WAIT_S = 120.0


def broker_pid(port: int) -> int:
    """Of the mosquitto that was started for this port."""
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and (process / "comm").read_text().strip() == "mosquitto":
            config = (process / "cmdline").read_bytes().split(b"\0")[2].decode()
            if f"listener {port} " in Path(config).read_text():
                return int(process.name)
    raise SystemExit("no mosquitto was found")


def cpu_s(pid: int) -> float:
    return sum(int((task / "schedstat").read_text().split()[0]) for task in Path(f"/proc/{pid}/task").iterdir()) / 1e9


def rss_kib(pid: int) -> int:
    rows = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(row.split()[1]) for row in rows if row.startswith("VmRSS"))


def connected(port: int, name: str) -> mqtt.Client:
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=name)
    client.max_inflight_messages_set(64)
    ready = threading.Event()
    client.on_connect = lambda *_: ready.set()
    client.connect("127.0.0.1", port)
    client.loop_start()
    if not ready.wait(WAIT_S):
        raise SystemExit("the broker took no connection")
    return client


def measured(clients: int, subscribers: int, messages: int, pace_per_s: float = 0.0) -> str:
    with tempfile.TemporaryDirectory() as name, Mosquitto(Path(name)) as broker:
        pid = broker_pid(broker.port)
        empty = rss_kib(pid)
        heard = [0] * subscribers
        listening = [connected(broker.port, f"s{i}") for i in range(subscribers)]
        for i, one in enumerate(listening):

            def count(_client: mqtt.Client, _data: object, _message: object, i: int = i) -> None:
                heard[i] += 1

            one.on_message = count
            one.subscribe("highside/#", qos=1)
        tools = [connected(broker.port, f"t{i}") for i in range(clients)]
        time.sleep(1.0)
        each, before, began = messages // clients, cpu_s(pid), time.monotonic()
        memory = (rss_kib(pid) - empty) / (clients + subscribers)
        lines = []
        for k in range(each):
            if pace_per_s:
                # tool by tool, as clocks that know nothing of each other
                for tool_number, tool in enumerate(tools):
                    due = began + (k + tool_number / clients) / pace_per_s
                    time.sleep(max(due - time.monotonic(), 0.0))
                    lines.append(tool.publish(f"highside/{tool_number}/attitude", PAYLOAD, qos=1))
            else:
                lines += [tool.publish(f"highside/{i}/attitude", PAYLOAD, qos=1) for i, tool in enumerate(tools)]
        for one in lines:
            one.wait_for_publish(WAIT_S)
        until = time.monotonic() + WAIT_S
        while min(heard, default=each * clients) < each * clients and time.monotonic() < until:
            time.sleep(0.1)
        used = cpu_s(pid) - before
        for one in (*tools, *listening):
            one.disconnect()
            one.loop_stop()
        pace = f" at {pace_per_s:g}/s" if pace_per_s else ""
        return (
            f"{clients} tools{pace}, {subscribers} subscribers: {1e6 * used / (each * clients):.0f} us a message,"
            f" {memory:.1f} KiB a connection, {each * clients} sent, heard {heard}"
        )


BRIDGE = (
    "connection office\naddress 127.0.0.1:{central}\nremote_clientid {name}\ncleansession false\n"
    "restart_timeout 1 30\ntopic highside/+/survey out 1\n"
)
PLAIN = "listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 100000\npersistence false\n"


def bridged(sites: int, clients: int, pace_per_s: float, seconds: float) -> str:
    """What the central broker of `sites` sites with `clients` tools each pays for a message, and what a site's does."""
    with tempfile.TemporaryDirectory() as name, Mosquitto(Path(name) / "office") as central:
        heard = [0]
        brokers = []
        for i in range(sites):
            folder = Path(name) / f"site-{i}"
            folder.mkdir()
            port = free_port()
            text = PLAIN.format(port=port) + BRIDGE.format(central=central.port, name=f"site-{i}")
            (folder / "mosquitto.conf").write_text(text + ("user root\n" if os.geteuid() == 0 else ""))
            brokers.append(Mosquitto(folder, config=folder / "mosquitto.conf", port=port))
            brokers[-1].start()
        reader = connected(central.port, "reader")
        reader.on_message = lambda *_: heard.__setitem__(0, heard[0] + 1)
        reader.subscribe("highside/#", qos=1)
        tools = [connected(broker.port, f"t{i}") for broker in brokers for i in range(clients)]
        time.sleep(3.0)
        pids = [broker_pid(central.port), broker_pid(brokers[0].port)]
        before, began, sent = [cpu_s(pid) for pid in pids], time.monotonic(), 0
        for k in range(round(seconds * pace_per_s)):
            for number, tool in enumerate(tools):
                time.sleep(max(began + (k + number / len(tools)) / pace_per_s - time.monotonic(), 0.0))
                tool.publish(f"highside/{number}/survey", PAYLOAD, qos=1)
                sent += 1
        until = time.monotonic() + WAIT_S
        while heard[0] < sent and time.monotonic() < until:
            time.sleep(0.1)
        office, site = (1e6 * (cpu_s(pid) - was) for pid, was in zip(pids, before, strict=True))
        for one in (*tools, reader):
            one.disconnect()
            one.loop_stop()
        for broker in brokers:
            broker.stop()
        return (
            f"{sites} sites of {clients} tools at {pace_per_s:g}/s, one reader at the office: {office / sent:.0f} us"
            f" a message there, {site * sites / sent:.0f} us at a site, {sent} sent, heard {heard[0]}"
        )


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    asked.add_argument("--clients", type=int, default=50)
    asked.add_argument("--messages", type=int, default=20_000)
    options = asked.parse_args()
    for clients, subscribers in ((1, 0), (options.clients, 0), (options.clients, 1), (options.clients, 3)):
        print(measured(clients, subscribers, options.messages), flush=True)
    for subscribers in (0, 1):
        # each message alone, as tools send: a turn of the broker's loop for each
        print(measured(options.clients, subscribers, 100 * options.clients, pace_per_s=10.0), flush=True)
    for sites in (1, 4):
        print(bridged(sites, options.clients // sites, 10.0, 10.0), flush=True)


if __name__ == "__main__":
    main()
