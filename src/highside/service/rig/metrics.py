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


@dataclass(frozen=True, slots=True)
class Figures:
    """What one scrape shows."""

    tool: str
    health: HealthMessage
    attitude: dict[str, float | None]


class MetricsServer:
    """Serves figures. `ask` is called in the event loop.

    Raises InputError where the extra is not installed or the address cannot be listened on.
    """

    def __init__(self, settings: MetricsSettings, ask: Callable[[], Figures], loop: asyncio.AbstractEventLoop) -> None:
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

    def figures(self) -> Figures | None:
        """From any thread; None while the loop does not answer."""

        async def ask() -> Figures:
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

    def __init__(self, figures: Callable[[], Figures | None]) -> None:
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


def metrics_of(figures: Figures) -> Iterator[Metric]:
    """All metrics of one moment, each labelled with the tool."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    tool, health = figures.tool, figures.health

    def gauge(name: str, text: str, value: float | None, **labels: str) -> GaugeMetricFamily:
        return many(GaugeMetricFamily, name, text, [(labels, value)])  # type: ignore[no-any-return]

    def many(kind: Any, name: str, text: str, values: Sequence[tuple[dict[str, str], float | None]]) -> Any:
        names = ["tool", *(values[0][0] if values else ())]
        family = kind(PREFIX + name, text, labels=names)
        for labels, value in values:
            if value is not None:
                family.add_metric([tool, *labels.values()], float(value))
        return family

    def counter(name: str, text: str, value: float) -> CounterMetricFamily:
        return many(CounterMetricFamily, name, text, [({}, value)])  # type: ignore[no-any-return]

    def counters(name: str, text: str, label: str, values: dict[str, Any]) -> CounterMetricFamily:
        flat = [({label: key}, float(value)) for key, value in values.items() if isinstance(value, (int, float))]
        return many(CounterMetricFamily, name, text, flat or [({label: "none"}, 0.0)])  # type: ignore[no-any-return]

    for name, text in (
        ("inc_deg", "Inclination of the hole from vertical, degrees."),
        ("inc_std_deg", "Standard deviation of the inclination, degrees."),
        ("tf_deg", "Gravity toolface of the sensor, degrees."),
        ("tf_std_deg", "Standard deviation of the toolface, degrees."),
        ("toolface_deg", "Toolface with the offset to the bend, degrees."),
        ("azi_deg", "Azimuth of the hole, degrees."),
        ("azi_std_deg", "Standard deviation of the azimuth, degrees."),
        ("g_total", "Magnitude of the corrected acceleration in local g."),
        ("temp_c", "Temperature of the sensor, degrees Celsius."),
    ):
        yield gauge(name, text, figures.attitude.get(name))
    yield gauge("uptime_seconds", "Since the service was started.", health.uptime_s)
    yield gauge("clock_synced", "Whether the wall clock follows a reference.", float(health.clock_synced))
    yield gauge("link_up", "Whether the link delivers.", float(health.link.get("state") == "up"))
    yield gauge("link_data_age_seconds", "Since the last bytes of the link.", health.link.get("data_age_s"))
    yield counters("link_events_total", "Events of the link.", "event", _numbers(health.link, ("opens", "losses")))
    yield counters("codec_total", "Where bytes and frames went.", "kind", dict(health.codec))
    yield counters("monitor_total", "What became of decoded frames.", "kind", _numbers(health.monitor))
    yield counter("attitudes_total", "Attitudes made.", health.pipeline["attitudes"])
    yield counters("surveys_total", "Surveys by verdict.", "verdict", _surveys(health))
    yield counters("surveys_refused_total", "Refused surveys by reason.", "reason", health.surveys.get("reasons", {}))
    yield gauge("survey_g_error_mg", "Gtotal of the last survey minus the site's.", health.surveys["trend"]["last_mg"])
    yield many(
        GaugeMetricFamily,
        "vibration_rms_g",
        "Shaking during the last second, rms.",
        [({"axis": axis}, value) for axis, value in zip("xyz", health.vibration["rms_g"], strict=True)],
    )
    yield many(
        GaugeMetricFamily,
        "vibration_peak_g",
        "Greatest peak of the last second.",
        [({"axis": axis}, value) for axis, value in zip("xyz", health.vibration["peak_g"], strict=True)],
    )
    yield many(
        CounterMetricFamily,
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
    yield many(
        CounterMetricFamily,
        "shocks_total",
        "Shocks at or above a level.",
        [
            ({"axis": axis, "level_g": f"{level:g}"}, count)
            for axis in "xyz"
            for level, count in zip(health.vibration["shock_levels_g"], health.vibration["shocks"][axis], strict=True)
        ],
    )
    outbox = health.outbox
    yield counter("outbox_produced_total", "Messages made.", outbox.produced)
    yield counter("outbox_acknowledged_total", "Messages that the broker has.", outbox.acknowledged)
    yield counters("outbox_dropped_total", "Messages dropped, by reason.", "reason", dict(outbox.dropped))
    yield gauge("outbox_queued", "Messages waiting for the broker.", outbox.queued)
    yield gauge("outbox_queued_bytes", "Bytes waiting for the broker.", outbox.queued_bytes)
    yield gauge("broker_connected", "Whether the broker is connected.", float(health.broker.connected))
    yield counter("broker_connects_total", "Connections made to the broker.", health.broker.connects)
    yield counter("broker_short_connections_total", "Those that ended within 5 s.", health.broker.short_connections)
    yield counter("replies_total", "Answers to commands that the broker has.", health.broker.replies)
    yield counter("replies_dropped_total", "Answers to commands beyond what is sent.", health.broker.replies_dropped)
    yield counter("commands_failed_total", "Commands that ended in a fault.", health.broker.commands_failed)
    yield gauge("loop_lag_p999_seconds", "Stalls of the event loop, 99.9 %.", health.loop.get("lag_p999_ms", 0.0) / 1e3)
    yield many(
        GaugeMetricFamily,
        "alarm",
        "1 for each alarm that stands.",
        [({"name": alarm}, 1.0) for alarm in health.alarms] or [({"name": "none"}, 0.0)],
    )
    yield many(
        GaugeMetricFamily,
        "calibration_info",
        "The calibration in force.",
        [({"cal_id": str(health.calibration.get("cal_id"))}, 1.0)],
    )


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
