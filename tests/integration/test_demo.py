"""`highside demo` as a newcomer runs it."""

from __future__ import annotations

import json
import re
import subprocess

import pytest
from daemon import HIGHSIDE

pytestmark = pytest.mark.slow


def test_demo_ends_with_one_line_of_json_nothing_lost_and_close_to_the_truth():
    run = subprocess.run([HIGHSIDE, "demo", "--seconds", "8", "--json"], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    lines = run.stdout.strip().splitlines()
    found = json.loads(lines[-1])
    assert found["lost"] == 0
    # 200 frames/s and 20 attitudes/s are due; a busy machine may start late
    assert found["frames"] >= 8 * 100
    assert found["published"] >= 8 * 10
    # the tool lies still at the end of 8 s; 20 attitudes a second, 10 readings each: six of their own sigmas
    assert abs(found["inc_deg"] - found["truth_inc_deg"]) < 6 * found["inc_std_deg"]
    assert abs((found["tf_deg"] - found["truth_tf_deg"] + 180) % 360 - 180) < 6 * found["tf_std_deg"]
    assert found["inc_error_rms_deg"] < 0.02
    assert found["surveys"] >= 1
    assert found["latency_p99_ms"] < 1000
    assert "Traceback" not in run.stderr


def test_demo_without_json_prints_lines_where_there_is_no_terminal():
    run = subprocess.run([HIGHSIDE, "demo", "--seconds", "12"], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert " I " in run.stdout
    assert "0 lost" in run.stdout.splitlines()[-1]
    # within ten seconds: what the calibration buys, and what a pulled plug does
    assert "uncorrected I" in run.stdout
    printed = run.stdout[run.stdout.index("the plug is pulled") :]
    assert (
        printed.index("noticed within") < printed.index("no data from the tool") < printed.index("the plug is in again")
    )
    missed = re.search(r"I and T again after \d+\.\d s; (\d+) frames missed and counted", printed)
    assert missed is not None
    assert int(missed[1]) >= 100, "1.5 s of 200 frames/s, less what a busy machine sent late"
    errors = re.search(r"rms error I (\S+) deg, T \S+ deg \(uncorrected: I (\S+) deg", printed)
    assert errors is not None
    assert float(errors[2]) > 10 * float(errors[1])
    assert "Traceback" not in run.stderr


def test_a_wrong_number_of_seconds_is_one_error_and_exit_status_2():
    run = subprocess.run([HIGHSIDE, "demo", "--seconds", "-1"], capture_output=True, text=True, timeout=30)
    assert run.returncode == 2
    assert "--seconds" in run.stderr
    assert "Traceback" not in run.stderr
