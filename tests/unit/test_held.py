"""What waits before it is processed: no output is later for it, and no chunking or loss changes what comes out."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from highside.calibration.correction import IdentityCorrection
from highside.codec.tool import ToolCodec, encode
from highside.config.settings import MonitorSettings, PipelineSettings, RollingBiasTable, SurveySettings, ToolSettings
from highside.link.base import Chunk
from highside.service.held import HELD_S
from highside.service.outputs import AttitudeOutput
from highside.service.pipeline import Pipeline


class Counting(ToolCodec):
    """Counts how often it is called with nothing else in between: each run of calls is one awakening of its code."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[float] = []
        self.now = 0.0

    def receive(self, data: bytes, t_mono: float = 0.0):
        self.times.append(self.now)
        return super().receive(data, t_mono)


def line(rate_hz: float = 10.0, codec: ToolCodec | None = None):
    out: list[AttitudeOutput] = []
    codec = codec or Counting()
    pipeline = Pipeline(
        codec=codec,
        tool=ToolSettings(),
        pipeline=PipelineSettings(output_rate_hz=rate_hz),
        monitor=MonitorSettings(),
        survey=SurveySettings(enabled=False),
        correction=IdentityCorrection(0.0, 0.0),
        rolling_bias=RollingBiasTable(),
        emit=out.append,
    )
    return pipeline, codec, out


def frame(k: int, rate_hz: float = 100.0) -> bytes:
    noise = random.Random(k)
    a = [value + noise.gauss(0.0, 1e-4) for value in (0.353, 0.353, 0.866)]
    return encode(k % 65536, k / rate_hz, a, temp_c=25.0)


@pytest.mark.parametrize("speed", [1.0, 10.0, 0.2])
@pytest.mark.parametrize("jitter_s", [0.0, 0.004])
def test_an_output_comes_with_the_frame_that_completes_it_however_fast_the_device_is(speed, jitter_s):
    pipeline, codec, out = line()
    rng, late = random.Random(3), 0
    for k in range(600):
        before = len(out)
        codec.now = k / 100.0 / speed + rng.uniform(0.0, jitter_s)
        pipeline.on_batch(Chunk(codec.now, 0.0, frame(k)))
        made = out[before:]
        if made and abs(made[-1].t_device_s - k / 100.0) > 1e-6:
            late += 1
    assert late == 0
    assert len(out) == 59


def test_at_ten_frames_an_output_the_decoder_is_called_for_ten_at_once():
    pipeline, codec, _ = line()
    for k in range(500):
        codec.now = k / 100.0
        pipeline.on_batch(Chunk(codec.now, 0.0, frame(k)))
    awakenings = 1 + sum(b > a for a, b in pairwise(codec.times))
    assert awakenings < 500 / 10 * 1.3


def test_frames_lost_on_the_way_make_no_output_late():
    pipeline, codec, out = line()
    rng, made_at = random.Random(5), {}
    for k in range(2000):
        if rng.random() < 0.3:
            continue
        codec.now, before = k / 100.0, len(out)
        pipeline.on_batch(Chunk(codec.now, 0.0, frame(k)))
        made_at.update({output.t_device_s: codec.now for output in out[before:]})
    # a frame of 0.01 s: with none that comes later than the one that completes it
    assert max(at - t for t, at in made_at.items()) < 0.005
    assert pipeline.monitor.counts.balanced()


def test_the_same_bytes_give_the_same_outputs_and_counts_in_any_chunks_with_noise_and_a_restart_between():
    rng = random.Random(7)
    parts = [frame(k) for k in range(400)] + [rng.randbytes(500)] + [frame(k) for k in range(400)]
    stream, results = b"".join(parts), []
    for least, most in ((1, 7), (26, 26), (1, 90), (4096, 4096)):
        pipeline, codec, out = line()
        at, cut = 0, random.Random(least)
        while at < len(stream):
            size = cut.randint(least, most)
            codec.now = at / 2600.0
            pipeline.on_batch(Chunk(codec.now, 0.0, stream[at : at + size]))
            at += size
        pipeline.finish()
        counts = codec.counts
        assert counts.balanced() and counts.bytes_in == len(stream)
        results.append(([(o.t_device_s, o.inc_deg, o.tf_deg, o.n) for o in out], counts, pipeline.monitor.counts))
    assert all(result == results[0] for result in results[1:])


def test_nothing_waits_for_longer_than_its_bound_and_everything_is_counted_when_it_is_asked_for():
    pipeline, codec, _ = line(rate_hz=0.1)
    waited = 0.0
    for k in range(3000):
        codec.now = k / 100.0
        pipeline.on_batch(Chunk(codec.now, 0.0, frame(k)))
        waited = max(waited, codec.now - codec.times[-1])
    assert 0.05 < waited <= HELD_S
    pipeline.process_held()
    assert codec.counts.bytes_in == 3000 * 26
    assert pipeline.monitor.counts.received == 3000


@pytest.mark.parametrize("rate_hz", [5e-324, 1e-300])
def test_any_output_rate_is_carried_out(rate_hz):
    """At the smallest number that a float holds the time until the next output is infinite."""
    pipeline, _, out = line(rate_hz)
    for k in range(100):
        pipeline.on_batch(Chunk(k / 100.0, 0.0, frame(k)))
    pipeline.process_held()
    assert pipeline.monitor.counts.good == 100
    assert not out
