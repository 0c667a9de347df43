"""`highside fleet archive` beside a real mosquitto: what was acknowledged is on the disk, through a SIGKILL."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pyarrow.parquet as pq
import pytest
from broker import Mosquitto
from daemon import HIGHSIDE, wait_for
from paho.mqtt.enums import CallbackAPIVersion

from highside.errors import InputError
from highside.fleet.archive import Archive, row_of

pytestmark = pytest.mark.slow


def rows(folder: Path, kind: str) -> list[dict[str, Any]]:
    return [row for path in folder.glob(f"{kind}/*/*.parquet") for row in pq.read_table(path).to_pylist()]


@pytest.mark.timeout(120)
def test_no_message_is_lost_by_an_archive_that_is_killed(tmp_path: Path) -> None:
    out = tmp_path / "archive"
    with Mosquitto(tmp_path / "broker") as broker:
        command = [str(HIGHSIDE), "fleet", "archive", "--port", str(broker.port), "--out", str(out), "--every", "0.3"]
        tool = mqtt.Client(CallbackAPIVersion.VERSION2)
        tool.connect("127.0.0.1", broker.port)
        tool.loop_start()

        def publish(first: int, last: int) -> None:
            for seq in range(first, last):
                said = {"seq": seq, "t": 1e9 + seq, "inc_deg": 30.0, "flags": ["g_total"], "cal_id": None}
                tool.publish("highside/t1/attitude", json.dumps(said), qos=1).wait_for_publish(10)

        def numbers() -> set[int]:
            return {row["seq"] for row in rows(out, "attitude")}

        first = subprocess.Popen(command)
        try:

            def heard() -> bool:
                publish(0, 1)
                return numbers() == {0}

            wait_for(heard, 60, "the archive to listen")
            publish(1, 40)
        finally:
            first.kill()
            first.wait(10)
        publish(40, 80)
        second = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            tool.publish("highside/t1/attitude", b"{", qos=1)
            tool.publish("highside/t1/survey", json.dumps({"seq": 1, "accepted": True, "g_std": 1e-4}), qos=1)
            wait_for(lambda: numbers() == set(range(80)) and rows(out, "survey"), 60, "all messages")
            second.send_signal(signal.SIGTERM)
            assert "1 damaged" in second.communicate(timeout=30)[0]
            assert second.returncode == 0
        finally:
            second.kill()
            tool.disconnect()
            tool.loop_stop()
    one = rows(out, "attitude")[0]
    assert (one["tool"], one["inc_deg"], one["flags"], one["azi_deg"]) == ("t1", 30.0, ["g_total"], None)
    assert rows(out, "survey")[0]["accepted"] is True


def test_a_message_without_a_number_is_damage_and_others_are_not_kept() -> None:
    assert row_of("highside/t1/health", b"{}") is None
    with pytest.raises(InputError, match="no sequence number"):
        row_of("highside/t1/attitude", b'{"seq": "x"}')


@pytest.mark.parametrize(
    "members",
    [
        b'"seq": true',
        b'"seq": 9223372036854775808',
        b'"seq": -1',
        b'"seq": 1.5',
        b'"seq": 1, "cal_id": "' + b"x" * 20_000 + b'"',
        b'"seq": 1, "t": 1' + b"0" * 400,
        b'"seq": 1, "cal_id": "\\ud800"',
    ],
)
def test_a_message_that_no_table_takes_is_damage_and_what_came_beside_it_is_kept(
    members: bytes, tmp_path: Path
) -> None:
    """It is acknowledged with the others: unacknowledged it would come again at each start, and end the archive."""
    archive = Archive(tmp_path)
    archive.take("highside/t1/attitude", b'{"seq": 7, "t": true, "flags": [1, "x"], "zone": 3}')
    archive.take("highside/t1/attitude", b"{%s}" % members)
    archive.flush()
    assert (archive.kept, archive.damaged) == (1, 1)
    (row,) = rows(tmp_path, "attitude")
    assert (row["seq"], row["t"], row["flags"], row["zone"]) == (7, None, ["x"], None)


@pytest.mark.parametrize("ca", ["absent.pem", "text.pem"])
def test_certificates_that_are_none_are_one_line(ca: str, tmp_path: Path) -> None:
    (tmp_path / "text.pem").write_text("no certificate\n")
    given = [str(HIGHSIDE), "fleet", "archive", "--port", "1", "--out", str(tmp_path), "--ca", str(tmp_path / ca)]
    done = subprocess.run(given, capture_output=True, text=True)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert f"{ca}: --ca: " in done.stderr


def test_a_broker_that_does_not_answer_is_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [str(HIGHSIDE), "fleet", "archive", "--port", "1", "--out", str(tmp_path)], capture_output=True, text=True
    )
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "127.0.0.1:1" in done.stderr


def test_the_toolface_of_the_bend_is_kept_by_either_name() -> None:
    for name in ("motor_toolface_deg", "toolface_deg"):
        kept = row_of("highside/t1/attitude", json.dumps({"seq": 1, name: 120.5}).encode())
        assert kept is not None and kept[1]["motor_toolface_deg"] == 120.5
