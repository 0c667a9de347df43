"""Texts as programs and loggers write them. Each function writes the notation of one of them and says what it is."""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
from foreign_session import RATE_HZ, START_NS, Session

AXES = "xyz"


@dataclass(frozen=True, slots=True)
class ForeignFile:
    """A file of a tool. `answer`: what the user says to the one question; `refused`: the reason instead of a recording.

    `columns`: of ours, what must come back; `coarse`: steps of the numbers, in g and in deg/s.
    """

    tool: str
    write: Callable[[Session], bytes]
    answer: dict[str, Any] = field(default_factory=dict)
    refused: str = ""
    columns: str = "ag"
    coarse: tuple[float, float] = (2e-5, 2e-3)


def lines(rows: Iterable[Sequence[object]], separator: str = ",", end: str = "\n") -> bytes:
    return "".join(separator.join(map(str, row)) + end for row in rows).encode()


def fixed(values: np.ndarray, digits: int = 6) -> list[list[str]]:
    """Cells (N, 3) of a block (3, N)."""
    return [[f"{value:.{digits}f}" for value in row] for row in values.T]


def frame(s: Session, accel: str, rate: str, **first: object) -> pd.DataFrame:
    """A table with names such as `accel_{}`."""
    made = pd.DataFrame(first)
    for k, axis in enumerate(AXES):
        made[accel.format(axis)] = s.accel_mps2[k]
    for k, axis in enumerate(AXES):
        made[rate.format(axis)] = s.rate_rads[k]
    return made


def pandas_index(s: Session) -> bytes:
    """`DataFrame.to_csv()` as most people leave it: index without a name, no units, times with six digits."""
    table = frame(s, "accel_{}", "gyro_{}", timestamp=pd.to_datetime(s.ns))
    return table.to_csv().encode()


def pandas_zone(s: Session) -> bytes:
    """`to_csv(index=False)` with times in UTC (`+00:00`), units as the last word of a name, and the bench's angles."""
    table = frame(s, "acc_{}_mps2", "gyr_{}_rads", time=pd.to_datetime(s.ns, utc=True))
    table["ref_inc_deg"], table["ref_tf_deg"] = s.inc_deg, s.tf_deg
    return table.to_csv(index=False).encode()


def polars_csv(s: Session) -> bytes:
    """`DataFrame.write_csv`: ISO 8601 with a `T` and six digits, shortest numbers."""
    table = pl.from_pandas(frame(s, "a{} [m/s^2]", "w{} [rad/s]", datetime=pd.to_datetime(s.ns)))
    return table.write_csv().encode()


def r_write_csv(s: Session) -> bytes:
    """R's `write.csv`: every name and the names of the rows in quotation marks, 15 digits."""
    head = ['""', '"time_s"', *(f'"acc_{a}_g"' for a in AXES), *(f'"gyr_{a}_dps"' for a in AXES)]
    body = [[f'"{k + 1}"', f"{s.t_s[k]:.15g}", *(f"{v:.15g}" for v in (*s.accel_g[:, k], *s.rate_dps[:, k]))]
            for k in range(s.n)]  # fmt: skip
    return lines([head, *body])


def matlab_timetable(s: Session) -> bytes:
    """MATLAB's `writetimetable`: durations with their unit in each cell, variables of three columns as `_1` to `_3`."""
    head = ["Time", *(f"Acc_{k}" for k in (1, 2, 3)), *(f"Gyr_{k}" for k in (1, 2, 3))]
    body = [[f"{s.t_s[k]:.5g} sec", *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([head, *body])


def excel_german(s: Session) -> bytes:
    """Excel's "CSV (Trennzeichen-getrennt)" in Germany: semicolons, decimal comma, day first, UTF-8 with a BOM."""
    head = ["Datum", *(f"Beschl. {a} acc (m/s²)" for a in "XYZ"), *(f"Drehrate {a} gyro (°/s)" for a in "XYZ")]
    body = [
        [f"{pd.Timestamp(int(s.ns[k])):%d.%m.%Y %H:%M:%S},{int(s.ns[k]) // 10**6 % 1000:03d}",
         *(cell.replace(".", ",") for cell in (*a, *w))]
        for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_dps), strict=True))
    ]  # fmt: skip
    return b"\xef\xbb\xbf" + lines([head, *body], ";", "\r\n")


def phyphox(s: Session) -> bytes:
    """phyphox, "Acceleration (with g)" with commas: names in quotation marks, `%.9E`."""
    head = ['"Time (s)"', *(f'"Acceleration {a} (m/s^2)"' for a in AXES), '"Absolute acceleration (m/s^2)"']
    size = np.linalg.norm(s.accel_mps2, axis=0)
    body = [[f"{v:.9E}" for v in (s.t_s[k], *s.accel_mps2[:, k], size[k])] for k in range(s.n)]
    return lines([head, *body])


def phyphox_european(s: Session) -> bytes:
    """The same export with the choice "semicolon, decimal comma"."""
    return phyphox(s).replace(b",", b";").replace(b".", b",")


def sensor_logger(s: Session) -> bytes:
    """Sensor Logger (Android, iOS), `TotalAcceleration.csv`: ns since 1970, axes from z to x, no units (m/s2)."""
    body = [[s.ns[k], f"{s.t_s[k]:.6f}", *(f"{v:.9f}" for v in s.accel_mps2[::-1, k])] for k in range(s.n)]
    return lines([["time", "seconds_elapsed", "z", "y", "x"], *body])


def physics_toolbox(s: Session) -> bytes:
    """Physics Toolbox Sensor Suite, "Multi Record": force in g as `gFx`, rates in rad/s as `wx`, seconds."""
    head = ["time", "gFx", "gFy", "gFz", "wx", "wy", "wz"]
    body = [[f"{s.t_s[k]:.6f}", *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_g), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([head, *body])


def androsensor(s: Session) -> bytes:
    """AndroSensor: semicolons, capitals, gravity and linear acceleration beside what was measured, ms since start."""
    kinds = ("ACCELEROMETER {} (m/s²)", "GRAVITY {} (m/s²)", "LINEAR ACCELERATION {} (m/s²)", "GYROSCOPE {} (rad/s)")
    head = [kind.format(a) for kind in kinds for a in "XYZ"]
    head += ["Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"]
    body = []
    for k in range(s.n):
        a, w = s.accel_mps2[:, k], s.rate_rads[:, k]
        when = f"{pd.Timestamp(int(s.ns[k])):%Y-%m-%d %H-%M-%S}_{int(s.ns[k]) // 10**6 % 1000:03d}"
        cells = [*(f"{v:.6f}" for v in a), *(f"{v:.6f}" for v in a), *(f"{0.001 * v:.6f}" for v in a)]
        body.append([*cells, *(f"{v:.6f}" for v in w), round(1000 * s.t_s[k]), when])
    return lines([head, *body], ";")


def xsens_manager(s: Session) -> bytes:
    """Xsens MT Manager's ASCII export: remarks after `//`, tabs, a clock of 10 kHz, m/s2 and rad/s without a name."""
    head = ["// Start Time: Unknown", f"// Sample rate: {RATE_HZ}Hz", "// Scenario: 4.9", "// Firmware Version: 4.0.2"]
    names = ["PacketCounter", "SampleTimeFine", *(f"Acc_{a}" for a in "XYZ"), *(f"Gyr_{a}" for a in "XYZ")]
    body = [[20 + k, 1_000 + round(1e4 * s.t_s[k]), *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([[line] for line in head]) + lines([names, *body], "\t")


def movella_dot(s: Session) -> bytes:
    """Movella DOT's export: `sep=,`, lines about the device, a clock of 1 MHz, m/s2 and deg/s without a name."""
    head = ["sep=,", "DeviceTag:,Movella DOT", "FirmwareVersion:,2.4.0", "SyncStatus:,Unsynced", "OutputRate:,50Hz"]
    names = ["PacketCounter", "SampleTimeFine", *(f"Acc_{a}" for a in "XYZ"), *(f"Gyr_{a}" for a in "XYZ")]
    body = [[1 + k, 5_016_667 + round(1e6 * s.t_s[k]), *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_dps), strict=True))]  # fmt: skip
    return lines([[line] for line in head]) + lines([names, *body])


def vectornav_ascii(s: Session) -> bytes:
    """A terminal's record of a VN-100 that sends `$VNIMU`: m/s2, rad/s, deg C, kPa; each line with its sum, no time."""
    out = []
    for k in range(s.n):
        cells = (0.1, 0.2, 0.3, *s.accel_mps2[:, k], *s.rate_rads[:, k])
        text = "VNIMU," + ",".join(f"{v:+09.5f}" for v in cells) + f",{s.temp_c[k]:+05.1f},+101.325"
        total = 0
        for byte in text.encode():
            total ^= byte
        out.append([f"${text}*{total:02X}"])
    return lines(out, end="\r\n")


def arduino_monitor(s: Session) -> bytes:
    """The serial monitor of the Arduino IDE with "Show timestamp": `14:02:33.120 -> ` before what a sketch prints."""
    out = []
    for k, (a, w) in enumerate(zip(fixed(s.accel_mps2, 4), fixed(s.rate_rads, 5), strict=True)):
        clock = f"{pd.Timestamp(int(s.ns[k])):%H:%M:%S}.{int(s.ns[k]) // 10**6 % 1000:03d}"
        out.append([f"{clock} -> " + ",".join((*a, *w))])
    return lines(out)


def mpu6050_raw(s: Session) -> bytes:
    """What the sketch `MPU6050_raw` of i2cdevlib prints: `a/g:` and six counts between tabs (16,384 and 131 a unit)."""
    body = [["a/g:", *np.rint(16384 * s.accel_g[:, k]).astype(int), *np.rint(131 * s.rate_dps[:, k]).astype(int)]
            for k in range(s.n)]  # fmt: skip
    return lines(body, "\t", "\r\n")


def ulog2csv(s: Session) -> bytes:
    """`ulog2csv` of PX4, topic `sensor_combined`: microseconds, the units within the names."""
    names = ["timestamp", *(f"gyro_rad[{k}]" for k in range(3)), "gyro_integral_dt", "accelerometer_timestamp_relative"]
    names += [*(f"accelerometer_m_s2[{k}]" for k in range(3)), "accelerometer_integral_dt", "accelerometer_clipping"]
    body = [[2_000 + round(1e6 * s.t_s[k]), *w, 20_000, 0, *a, 20_000, 0]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([names, *body])


def rostopic_csv(s: Session) -> bytes:
    """`rostopic echo -b FILE -p /imu`: `%time` in ns, `field.` before each name, covariances beside."""
    covariance = [f"field.linear_acceleration_covariance{k}" for k in range(9)]
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += [f"field.orientation.{a}" for a in "xyzw"] + [f"field.angular_velocity.{a}" for a in AXES]
    names += [f"field.linear_acceleration.{a}" for a in AXES] + covariance
    body = [[s.ns[k], k, s.ns[k], "imu_link", "0.0", "0.0", "0.0", "1.0", *w, *a, *["0.0"] * 9]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([names, *body])


def plotjuggler(s: Session) -> bytes:
    """PlotJuggler's "CSV Exporter" of a topic `sensor_msgs/Imu`: `__time` in s since 1970, paths as names."""
    names = ["__time", *(f"/imu/data/linear_acceleration/{a}" for a in AXES)]
    names += [f"/imu/data/angular_velocity/{a}" for a in AXES]
    body = [[f"{s.ns[k] // 10**9}.{s.ns[k] % 10**9 // 1000:06d}", *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_rads), strict=True))]  # fmt: skip
    return lines([names, *body])


def axivity_omgui(s: Session) -> bytes:
    """Axivity's OMGUI: no header, `YYYY-MM-DD HH:MM:SS.mmm`, x, y, z in g."""
    body = [[f"{pd.Timestamp(int(s.ns[k])):%Y-%m-%d %H:%M:%S}.{int(s.ns[k]) // 10**6 % 1000:03d}", *a]
            for k, a in enumerate(fixed(s.accel_g))]  # fmt: skip
    return lines(body)


def actigraph(s: Session) -> bytes:
    """ActiLife's raw export: ten lines about the device with the rate, then g without units and without times."""
    head = ["------------ Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v3.2.1 date format M/d/yyyy"
            f" at {RATE_HZ:.0f} Hz  Filter Normal -----------", "Serial Number: NEO1F00000000",
            "Start Time 18:41:18", "Start Date 7/12/2025", "Epoch Period (hh:mm:ss) 00:00:00",
            "Download Time 19:00:00", "Download Date 7/12/2025", "Current Memory Address: 0",
            "Current Battery Voltage: 4.19     Mode = 12",
            "--------------------------------------------------"]  # fmt: skip
    names = [f"Accelerometer {a}" for a in "XYZ"]
    return lines([[line] for line in head], end="\r\n") + lines([names, *fixed(s.accel_g, 3)], end="\r\n")


def metawear(s: Session) -> bytes:
    """MbientLab's MetaBase: ms since 1970, the time in words, seconds since the start, `x-axis (g)`."""
    body = [[s.ns[k] // 10**6, f"{pd.Timestamp(int(s.ns[k])):%Y-%m-%dT%H:%M:%S}.{int(s.ns[k]) // 10**6 % 1000:03d}",
             f"{s.t_s[k]:.3f}", *a] for k, a in enumerate(fixed(s.accel_g, 3))]  # fmt: skip
    return lines([["epoc (ms)", "timestamp (+0000)", "elapsed (s)", "x-axis (g)", "y-axis (g)", "z-axis (g)"], *body])


def shimmer_consensys(s: Session) -> bytes:
    """Shimmer's Consensys: `"sep=\\t"`, names, then a line of units, tabs; ms since 1970 with decimals."""
    names = ["Shimmer_6749_Timestamp_Unix_CAL", *(f"Shimmer_6749_Accel_WR_{a}_CAL" for a in "XYZ")]
    names += [f"Shimmer_6749_Gyro_{a}_CAL" for a in "XYZ"]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]
    body = [[f"{s.ns[k] / 1e6:.4f}", *a, *w]
            for k, (a, w) in enumerate(zip(fixed(s.accel_mps2), fixed(s.rate_dps), strict=True))]  # fmt: skip
    return b'"sep=\t"\n' + lines([names, units, *body], "\t")


def st_mems_studio(s: Session) -> bytes:
    """ST's MEMS Studio and AlgoBuilder: units in brackets, whole mg and mdps, us."""
    names = ["time[us]", *(f"acc_{a}[mg]" for a in AXES), *(f"gyro_{a}[mdps]" for a in AXES)]
    body = [[round(1e6 * s.t_s[k]), *np.rint(1000 * s.accel_g[:, k]).astype(int),
             *np.rint(1000 * s.rate_dps[:, k]).astype(int)] for k in range(s.n)]  # fmt: skip
    return lines([names, *body])


def labview_lvm(s: Session) -> bytes:
    """LabVIEW's measurement file (.lvm): a header in two parts that ends with `***End_of_Header***`, tabs, X_Value."""
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
            "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tAbsolute", "***End_of_Header***", "",
            "Channels\t3\t\t\t", f"Samples\t{s.n}\t{s.n}\t{s.n}\t", "Y_Unit_Label\tg\tg\tg\t",
            "***End_of_Header***\t\t\t\t", "X_Value\tacc_x\tacc_y\tacc_z\tComment"]  # fmt: skip
    body = [[f"{s.t_s[k]:.6f}", *a, ""] for k, a in enumerate(fixed(s.accel_g))]
    return lines([[line] for line in head], end="\r\n") + lines(body, "\t", "\r\n")


def american_loggers(s: Session) -> bytes:
    """Excel in America over a logger's file: `7/12/2025 6:41:18 PM`, which has no parts of a second."""
    start = datetime.datetime.fromtimestamp(START_NS / 1e9, datetime.UTC)
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(["Time", *(f"Accel {a} (g)" for a in "XYZ")])
    for k, a in enumerate(fixed(s.accel_g)):
        when = start + datetime.timedelta(seconds=int(s.t_s[k]))
        writer.writerow([f"{when.month}/{when.day}/{when.year} {when:%I:%M:%S %p}", *a])
    return out.getvalue().encode()


def influx_annotated(s: Session) -> bytes:
    """InfluxDB's annotated CSV: one value a line, its name in `_field`."""
    out = [
        "#datatype,string,long,dateTime:RFC3339Nano,double,string,string",
        "#group,false,false,false,false,true,true",
        "#default,_result,,,,,",
        ",result,table,_time,_value,_field,_measurement",
    ]
    for axis, values in zip(AXES, s.accel_g, strict=True):
        for k in range(s.n):
            when = f"{pd.Timestamp(int(s.ns[k])):%Y-%m-%dT%H:%M:%S}.{int(s.ns[k]) // 10**6 % 1000:03d}Z"
            out.append(f",,0,{when},{values[k]:.6f},a{axis},imu")
    return lines([[line] for line in out])


def candump(s: Session) -> bytes:
    """`candump -L`: frames that only a DBC file explains."""
    return lines([[f"({s.ns[k] // 10**9}.{s.ns[k] % 10**9 // 1000:06d}) can0 101#{k:016X}"] for k in range(s.n)])
