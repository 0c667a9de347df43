"""Real hand sessions played through the session as a plan of no fixed length: poses found by themselves."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from rehearsal import WALL_S, command

from highside.bench.session import outcome, plans
from highside.bench.session.entries import Entry, RefusedHold
from highside.bench.session.journal import Encoder, Header, read_journal
from highside.bench.session.session import BenchSession
from highside.bench.session.snapshot import CommandName, SessionState
from highside.calibration.magnitude import leave_one_out_errors
from highside.calibration.record import Environment
from highside.codec.frame import Frame

RATE_HZ = 100.0


def recording(folder: Path, name: str) -> np.ndarray:
    """Readings (3, N) in nominal g."""
    if name == "imu_tk":
        with np.load(folder / "imu_tk_xsens_mti.npz") as data:
            return (data["acc"].T.astype(float) - 2**15) / 2**12
    with gzip.open(folder / f"{name}.log.gz", "rt") as lines:
        return np.asarray(np.loadtxt(lines)[:, :3].T / 9.80665)


# poses, and the rms of |a| over poses left out that is to be reached, mg
@pytest.mark.parametrize(
    ("name", "count", "bar_mg"), [("imu_tk", 38, 0.16), ("mpu9150_imu0", 22, 0.37), ("mpu9150_imu1", 22, 0.33)]
)
def test_every_pose_is_found_by_itself_and_the_ones_left_out_are_predicted(
    shared_data: Path, name: str, count: int, bar_mg: float
) -> None:
    a = recording(shared_data / "accel_multipose", name)
    header = Header("real", "hand", None, plans.unguided_plan(), Environment(), None, "0", WALL_S)
    encoder = Encoder()
    lines = [encoder.header(header)]
    entries: list[Entry] = []

    def write(entry: Entry) -> None:
        entries.append(entry)
        lines.append(encoder.entry(entry, WALL_S))

    session = BenchSession(header, write, lambda: WALL_S)
    session.command(command(CommandName.START), 0.0)
    for first in range(0, a.shape[1], 37):  # batches that fit no window
        rows = a[:, first : first + 37].T.tolist()
        times = [(first + k) / RATE_HZ for k in range(len(rows))]
        session.readings([Frame(None, t, t, *row) for t, row in zip(times, rows, strict=True)], times[-1])
    session.data_ended(a.shape[1] / RATE_HZ)
    job = session.work()
    assert job is not None
    session.finish_work(job(), 0.0)
    assert session.state is SessionState.REVIEW
    poses = session.ledger.pose_set()
    assert len(poses) == count
    assert not [entry for entry in entries if isinstance(entry, RefusedHold)]
    errors_mg = 1e3 * leave_one_out_errors(poses)
    rms = float(np.sqrt(np.mean(errors_mg**2)))
    print(f"{name}: {len(poses)} poses, left-out rms {rms:.3f} mg")
    assert rms <= bar_mg
    assert session.command(command(CommandName.ACCEPT), 0.0).accepted
    assert session.record is not None and session.record.result.poses.used.all()
    replayed = outcome.replay(read_journal(b"".join(lines)))
    assert replayed[2] is not None and replayed[2].id == session.record.id
