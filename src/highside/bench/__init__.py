"""The calibration at the bench: a pure session (`bench.session`) and what drives it.

`bench.driver.BenchDriver` owns link, codec, monitor, journal file and store, and gives good frames, raw, to the
session. A face (the terminal, the page, MQTT in `bench.mqtt`) holds a `SessionDriver` and nothing else.
"""

from __future__ import annotations

__all__ = ["driver", "journal_file", "mqtt", "session", "setup", "simulated_bench", "simulated_operator", "store"]
"""the ways in: modules, loaded on request"""
