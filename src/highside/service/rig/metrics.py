"""Figures for Prometheus, in the text format of its own client library (extra `metrics`).

Every scrape asks the event loop for the health message of that moment and for the latest attitude; the library's own
small server, in a thread, speaks HTTP. Names follow Prometheus' conventions: base units, `_total` for counters.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from highside.config.rig import MetricsSettings
from highside.errors import InputError
from highside.service.messages import HealthMessage

if TYPE_CHECKING:
    from prometheus_client.core import Metric

log = logging.getLogger(__name__)

ANSWER_WITHIN_S = 2.0
PREFIX = "highside_"

Labelled = Sequence[tuple[dict[str, str], float | None]]
"""values, each with its labels; None: not known now"""


@dataclass(frozen=True, slots=True)
class Scrape:
    """What one scrape shows."""

    tool: str
    health: HealthMessage
    attitude: dict[str, float | None]


class MetricsServer:
    """Serves figures. `ask` is called in the event loop.

    Raises InputError where the extra is not installed or the address cannot be listened on.
    """

    def __init__(self, settings: MetricsSettings, ask: Callable[[], Scrape], loop: asyncio.AbstractEventLoop) -> None:
        try:
            import prometheus_client as prometheus
        except ImportError:
            raise InputError(
                "needs the Prometheus client library",
                field="the [metrics] table",
                remedy="install highside[metrics], or take the table away",
            ) from None
        self._ask, self._loop = ask, loop
        registry = prometheus.CollectorRegistry()
        registry.register(_Collector(self.figures))
        try:
            self._server, self._thread = prometheus.start_http_server(settings.port, settings.host, registry)
        except OSError as error:
            raise InputError(
                f"cannot listen on {settings.host}:{settings.port}: {error.strerror or error}",
                field="the [metrics] table",
                remedy="choose another port",
            ) from None
        self.port: int = self._server.server_port
        self.closed = False
        log.info("metrics at http://%s:%d/metrics", settings.host, self.port)

    def figures(self) -> Scrape | None:
        """From any thread; None while the loop does not answer."""

        async def ask() -> Scrape:
            return self._ask()

        future = asyncio.run_coroutine_threadsafe(ask(), self._loop)
        try:
            return future.result(ANSWER_WITHIN_S)
        except (TimeoutError, concurrent.futures.CancelledError):
            future.cancel()
            return None

    def close(self) -> None:
        """End the server; waits for a scrape under way (call from a thread)."""
        self._server.shutdown()
        self._server.server_close()
        self.closed = True
        self._thread.join(ANSWER_WITHIN_S)


class _Collector:
    """What prometheus_client asks at each scrape."""

    def __init__(self, figures: Callable[[], Scrape | None]) -> None:
        self._figures = figures

    def describe(self) -> Iterable[Metric]:
        return ()

    def collect(self) -> Iterator[Metric]:
        from prometheus_client.core import GaugeMetricFamily

        figures = self._figures()
        up = GaugeMetricFamily(PREFIX + "up", "Whether the service answered this scrape.")
        up.add_metric([], 0.0 if figures is None else 1.0)
        yield up
        if figures is not None:
            yield from metrics_of(figures)


class _Families:
    """Makes the metrics of one tool."""

    def __init__(self, tool: str) -> None:
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        self._tool, self._gauge, self._counter = tool, GaugeMetricFamily, CounterMetricFamily

    def _family(self, kind: Any, name: str, text: str, values: Labelled) -> Metric:
        names = ["tool", *(values[0][0] if values else ())]
        family: Metric = kind(PREFIX + name, text, labels=names)
        for labels, value in values:
            if value is not None:
                family.add_metric([self._tool, *labels.values()], float(value))  # type: ignore[attr-defined]
        return family

    def gauges(self, name: str, text: str, values: Labelled) -> Metric:
        return self._family(self._gauge, name, text, values)

    def totals(self, name: str, text: str, values: Labelled) -> Metric:
        return self._family(self._counter, name, text, values)

    def gauge(self, name: str, text: str, value: float | None) -> Metric:
        return self.gauges(name, text, [({}, value)])

    def counter(self, name: str, text: str, value: float) -> Metric:
        return self.totals(name, text, [({}, value)])

    def counters(self, name: str, text: str, label: str, values: dict[str, Any]) -> Metric:
        flat = [({label: key}, float(value)) for key, value in values.items() if isinstance(value, (int, float))]
        return self.totals(name, text, flat or [({label: "none"}, 0.0)])


ATTITUDE = (
    ("inc_deg", "Inclination of the hole from vertical, degrees."),
    ("inc_std_deg", "Standard deviation of the inclination, degrees."),
    ("tf_deg", "Gravity toolface of the sensor, degrees."),
    ("tf_std_deg", "Standard deviation of the toolface, degrees."),
    ("motor_toolface_deg", "Toolface with the offset to the motor's bend, degrees."),
    ("azi_deg", "Azimuth of the hole, degrees."),
    ("azi_std_deg", "Standard deviation of the azimuth, degrees."),
    ("g_total", "Magnitude of the corrected acceleration in local g."),
    ("temp_c", "Temperature of the sensor, degrees Celsius."),
)
"""The figures of the latest attitude: member of the message, and what it is."""


def metrics_of(figures: Scrape) -> Iterator[Metric]:
    """All metrics of one moment, each labelled with the tool."""
    of, health = _Families(figures.tool), figures.health
    for name, text in ATTITUDE:
        yield of.gauge(name, text, figures.attitude.get(name))
    yield from _acquisition(of, health)
    yield from _vibration(of, health)
    yield from _watch(of, health)
    yield from _delivery(of, health)
    yield of.gauge(
        "loop_lag_p999_seconds", "Stalls of the event loop, 99.9 %.", health.loop.get("lag_p999_ms", 0.0) / 1e3
    )
    yield of.gauges(
        "alarm",
        "1 for each alarm that stands.",
        [({"name": alarm}, 1.0) for alarm in health.alarms] or [({"name": "none"}, 0.0)],
    )
    yield of.gauges(
        "calibration_info",
        "The calibration in force.",
        [({"cal_id": str(health.calibration.get("cal_id"))}, 1.0)],
    )


def _acquisition(of: _Families, health: HealthMessage) -> Iterator[Metric]:
    """Clock, link, codec, attitudes and surveys."""
    yield of.gauge("uptime_seconds", "Since the service was started.", health.uptime_s)
    yield of.gauge("clock_synced", "Whether the wall clock follows a reference.", float(health.clock_synced))
    yield of.gauge("link_up", "Whether the link delivers.", float(health.link.get("state") == "up"))
    yield of.gauge("link_data_age_seconds", "Since the last bytes of the link.", health.link.get("data_age_s"))
    yield of.counters("link_events_total", "Events of the link.", "event", _numbers(health.link, ("opens", "losses")))
    yield of.counters("codec_total", "Where bytes and frames went.", "kind", dict(health.codec))
    yield of.counters("monitor_total", "What became of decoded frames.", "kind", _numbers(health.monitor))
    yield of.counter("attitudes_total", "Attitudes made.", health.pipeline["attitudes"])
    yield of.counters("surveys_total", "Surveys by verdict.", "verdict", _surveys(health))
    yield of.counters(
        "surveys_refused_total", "Refused surveys by reason.", "reason", health.surveys.get("reasons", {})
    )
    yield of.gauge(
        "survey_g_error_mg", "Gtotal of the last survey minus the site's.", health.surveys["trend"]["last_mg"]
    )


def _vibration(of: _Families, health: HealthMessage) -> Iterator[Metric]:
    """Shaking and shocks, by axis and level."""
    yield of.gauges(
        "vibration_rms_g",
        "Shaking during the last second, rms.",
        [({"axis": axis}, value) for axis, value in zip("xyz", health.vibration["rms_g"], strict=True)],
    )
    yield of.gauges(
        "vibration_peak_g",
        "Greatest peak of the last second.",
        [({"axis": axis}, value) for axis, value in zip("xyz", health.vibration["peak_g"], strict=True)],
    )
    yield of.totals(
        "vibration_seconds_total",
        "Seconds at or above a level of rms.",
        [
            ({"axis": axis, "level_g": f"{level:g}"}, seconds)
            for axis in "xyz"
            for level, seconds in zip(
                health.vibration["rms_levels_g"], health.vibration["seconds_at_level"][axis], strict=True
            )
        ],
    )
    yield of.totals(
        "shocks_total",
        "Shocks at or above a level.",
        [
            ({"axis": axis, "level_g": f"{level:g}"}, count)
            for axis in "xyz"
            for level, count in zip(health.vibration["shock_levels_g"], health.vibration["shocks"][axis], strict=True)
        ],
    )


def _watch(of: _Families, health: HealthMessage) -> Iterator[Metric]:
    """Whether the calibration still holds."""
    watch = health.watch or {}
    verdict = watch.get("verdict")
    if verdict is None:
        return
    yield of.gauges(
        "watch_verdict",
        "1 for what the watch of the calibration says.",
        [({"verdict": name}, float(name == verdict)) for name in ("learning", "holds", "departs")],
    )
    for name, member, text in (
        ("watch_deviation", "deviation", "Deviation of a parameter from the calibration in force, in its own unit."),
        ("watch_deviation_std", "std", "Its standard deviation."),
    ):
        yield of.gauges(name, text, [({"parameter": key}, value) for key, value in watch[member].items()])
    yield of.gauges(
        "watch_noise_factor",
        "Scatter of an axis at rest against that of before, where it has changed; else 1.",
        [({"axis": axis}, watch["noise"].get(axis, 1.0)) for axis in "xyz"],
    )
    yield of.gauge("watch_inc_error_deg", "What departs does to inclination now.", watch["inc_error_deg"])
    yield of.gauge(
        "watch_tf_sin_inc_error_deg",
        "What departs does to toolface times the sine of the inclination now.",
        watch["tf_sin_inc_error_deg"],
    )
    yield of.counters(
        "watch_measurements_total", "What the watch has used.", "kind", _numbers(watch, ("stills", "turns", "dropped"))
    )


def _delivery(of: _Families, health: HealthMessage) -> Iterator[Metric]:
    """What waits for the broker, and the connection to it."""
    outbox = health.outbox
    yield of.counter("outbox_produced_total", "Messages made.", outbox.produced)
    yield of.counter("outbox_acknowledged_total", "Messages that the broker has.", outbox.acknowledged)
    yield of.counters("outbox_dropped_total", "Messages dropped, by reason.", "reason", dict(outbox.dropped))
    yield of.gauge("outbox_queued", "Messages waiting for the broker.", outbox.queued)
    yield of.gauge("outbox_queued_bytes", "Bytes waiting for the broker.", outbox.queued_bytes)
    yield of.gauge("broker_connected", "Whether the broker is connected.", float(health.broker.connected))
    yield of.counter("broker_connects_total", "Connections made to the broker.", health.broker.connects)
    yield of.counter("broker_short_connections_total", "Those that ended within 5 s.", health.broker.short_connections)
    yield of.counter("replies_total", "Answers to commands that the broker has.", health.broker.replies)
    yield of.counter("replies_dropped_total", "Answers to commands beyond what is sent.", health.broker.replies_dropped)
    yield of.counter("commands_failed_total", "Commands that ended in a fault.", health.broker.commands_failed)


def _surveys(health: HealthMessage) -> dict[str, int]:
    return {"accepted": health.surveys["accepted"], "refused": health.surveys["refused"]}


def _numbers(table: dict[str, Any], names: tuple[str, ...] | None = None) -> dict[str, float]:
    flat: dict[str, float] = {}
    for key, value in table.items():
        if isinstance(value, bool) or (names is not None and key not in names):
            continue
        if isinstance(value, (int, float)):
            flat[key] = value
        elif isinstance(value, dict):
            flat |= {f"{key}_{name}": v for name, v in value.items() if isinstance(v, (int, float))}
    return flat
