"""`highside rotation ...`: fit an error against the rotor angle, take it off, and compare the methods."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.say import echo, echo_json
from highside.cli.self_fit import fit_self
from highside.cli.turntable import read_compensation, turntable
from highside.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.recording.table import Recording
    from highside.rotation import Compensation
    from highside.rotation.compare import Comparison
    from highside.rotation.curve import Curve
    from highside.rotation.direction import DirectionDifference, Motion
    from highside.rotation.samples import Samples

    Floats = NDArray[np.float64]

app = typer.Typer(
    name="rotation", no_args_is_help=True, help="Errors that repeat with the rotor angle: fit, apply, compare."
)

app.command()(turntable)
app.command("fit-self")(fit_self)

CHANNELS = ("roll", "pitch", "heading", "inclination", "toolface")
LARGEST_ERROR_ARCMIN = 1800.0
LARGEST_STEP_DEG = 720.0
FAR_STEP_DEG = 60.0
LONG_RECORDING = 200


class MethodName(StrEnum):
    """How the error is fitted."""

    SINE = "sine"
    HARMONICS2 = "harmonics2"
    POLYNOMIAL9 = "polynomial9"
    NETWORK = "network"
    AUTO = "auto"


class InputName(StrEnum):
    """What the network sees of the angle."""

    SCALED = "scaled"
    PERIODIC = "periodic"


RecordingArgument = Annotated[
    Path,
    typer.Argument(
        metavar="REC",
        help="Recording (CSV): t_s, rotor_deg, and any of d_roll_arcmin, d_pitch_arcmin, d_heading_arcmin,"
        " d_inclination_arcmin, d_toolface_arcmin.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]
PageOption = Annotated[Path | None, typer.Option("--html", help="Page with plots to write.")]


@app.command("fit")
def fit_command(
    recording: RecordingArgument,
    output: Output,
    method: Annotated[MethodName, typer.Option(help="How to fit.")] = MethodName.AUTO,
    rate_terms: Annotated[int, typer.Option(help="Powers of the rotor rate, 0 to 2 (polynomial9, auto).")] = 0,
    network_input: Annotated[InputName, typer.Option(help="For the network.")] = InputName.SCALED,
    seed: Annotated[int, typer.Option(help="For the network: its first weights.")] = 0,
    inclination_deg: Annotated[float | None, typer.Option(help="Inclination at which it was recorded.")] = None,
    roll_deg: Annotated[float | None, typer.Option(help="Roll of the vehicle at which it was recorded.")] = None,
    pitch_deg: Annotated[float | None, typer.Option(help="Pitch of the vehicle at which it was recorded.")] = None,
    html: PageOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fit each error of a recording against the rotor angle and write a compensation."""
    import hashlib

    from highside.reading import read_bytes
    from highside.recording.files import write_whole
    from highside.rotation import Compensation, FitOptions, Method, NetworkInput, Validity, fit
    from highside.rotation.direction import direction_difference

    table = _read(recording)
    options = FitOptions(rate_terms, NetworkInput(network_input.value), seed)
    known = dict(_samples(table, rate_terms > 0))
    curves = {channel: fit(samples, Method(method.value), options) for channel, samples in known.items()}
    compensation = Compensation(
        curves,
        Validity(inclination_deg, roll_deg, pitch_deg),
        recording.name,
        hashlib.sha256(read_bytes(recording)).hexdigest(),
        _motion(table),
    )
    by_direction = {channel: direction_difference(known[channel], curve) for channel, curve in curves.items()}
    page = None
    if html is not None:
        from highside.report.rotation_page import fit_page

        page = fit_page(compensation, known)
    write_whole(output, compensation.to_json().encode())
    if html is not None and page is not None:
        write_whole(html, page.encode())
    described = {
        name: _described(curve) | {"direction": None if (found := by_direction[name]) is None else found.to_dict()}
        for name, curve in curves.items()
    }
    if as_json:
        echo_json(json.dumps({"output": str(output), "id": compensation.id, "curves": described}))
        return
    echo(f"{output}: {method.value} of {table.n} rows, {compensation.id[:12]}")
    for name, one in described.items():
        held_out = "" if one["held_out_rms_arcmin"] is None else f", held out {one['held_out_rms_arcmin']:.4f}'"
        echo(
            f"  {name:<8} order {one['order']:<2} noise {one['noise_arcmin']:.4f}', amplitude"
            f" {one['half_range_arcmin']:.4f}'{held_out}"
        )
    for name, curve in curves.items():
        difference = by_direction[name]
        for remark in (*curve.remarks, *([difference.sentence] if difference is not None and difference.found else [])):
            echo(f"{name}: {remark}", err=True)


@app.command()
def apply(
    compensation_file: Annotated[Path, typer.Argument(metavar="COMP", help="Compensation (JSON) of rotation fit.")],
    recording: RecordingArgument,
    output: Output,
    as_json: JsonOption = False,
) -> None:
    """Take the fitted errors off, of errors and of attitudes as the live service does.

    Of d_roll_arcmin, ... it makes d_roll_comp_arcmin, ... = measured - fitted. Of inc_deg, tf_deg (`calibrate apply`)
    and azi_deg (`drift`, which follows the sensors' package) it makes inc_comp_deg, tf_comp_deg, azi_comp_deg; to
    inc_std_deg, ... its own variance is added.
    """
    import numpy as np

    from highside.cli.rotation_attitude import compensated_attitude

    compensation = read_compensation(compensation_file)
    table = _read(recording)
    added: dict[str, Floats] = {}
    left: dict[str, dict[str, float]] = {}
    attitude = compensated_attitude(table, compensation)
    has_errors = any(table.has(f"d_{channel}_arcmin") for channel in CHANNELS)
    with_rate = any(c.rate is not None for c in compensation.curves.values())
    for channel, samples in _samples(table, with_rate) if has_errors or not attitude.columns else ():
        curve = compensation.curves.get(channel)
        if curve is None:
            continue
        name = f"d_{channel}_arcmin"
        kept = np.isfinite(table.columns[name]) & np.isfinite(table.columns["rotor_deg"])
        out = np.full(table.n, np.nan)
        out[kept] = samples.error - curve(samples.theta_rad, samples.rate_radps)
        added[f"d_{channel}_comp_arcmin"] = out
        left[channel] = {
            "before_mean_abs_arcmin": float(np.mean(np.abs(samples.error))),
            "after_mean_abs_arcmin": float(np.mean(np.abs(out[kept]))),
        }
    if not added and not attitude.columns:
        raise InputError(
            f"has none of the errors this compensation is for ({', '.join(compensation.curves)})",
            where=str(recording),
            remedy=f"give {' or '.join(f'd_{name}_arcmin' for name in compensation.curves)}, or inc_deg with tf_deg or"
            " azi_deg",
        )
    table.with_columns(added | attitude.columns).write(output)
    warnings = [*_beyond_validity(table, compensation), *_never_seen(table, compensation)]
    for warning in warnings:
        echo(f"warning: {warning}", err=True)
    if as_json:
        said = {
            "output": str(output),
            "id": compensation.id,
            "rows": table.n,
            "channels": left,
            "warning": warnings[0] if warnings else None,
            "warnings": warnings,
        }
        echo_json(json.dumps(said | {"attitude": attitude.said}))
        return
    echo(f"{output}: {table.n} rows compensated by {compensation.id[:12]}")
    for channel, one in left.items():
        echo(
            f"  {channel:<8} mean absolute error {one['before_mean_abs_arcmin']:.4f}' ->"
            f" {one['after_mean_abs_arcmin']:.4f}'"
        )
    for name, counts in attitude.said.items():
        why = ", ".join(f"{n} {flag}" for flag, n in counts.items() if n and flag != "compensated")
        echo(f"  {name:<8} {counts['compensated']} rows compensated{f'; {why}' if why else ''}")


def _motion(table: Recording) -> Motion:
    """How the rotor moved, from the rows whose angle is known."""
    import numpy as np

    from highside.rotation.direction import Motion

    known = np.isfinite(table.columns["rotor_deg"])
    return Motion.of(table.t_s[known], np.radians(table.columns["rotor_deg"][known]))


def _never_seen(table: Recording, compensation: Compensation) -> list[str]:
    """A line for each direction and range of rates in the recording that the fit never saw."""
    return [] if compensation.motion is None else compensation.motion.never_seen_here(_motion(table))


def _beyond_validity(table: Recording, compensation: Compensation) -> list[str]:
    """A line if the recording says that it was made far from the inclination at which the compensation was fitted."""
    import numpy as np

    validity = compensation.validity
    if validity.inclination_deg is None or not table.has("inc_ref_deg"):
        return []
    off = np.abs(table.columns["inc_ref_deg"] - validity.inclination_deg)
    beyond = int(np.sum(off > validity.within_deg))
    if not beyond:
        return []
    return [
        f"{beyond} of {table.n} rows lie up to {np.nanmax(off):.1f} deg from the inclination of"
        f" {validity.inclination_deg:g} deg at which the compensation was fitted: its coefficients change with attitude"
    ]


def _described(curve: Curve) -> dict[str, Any]:
    import numpy as np

    theta = np.linspace(0.0, 2.0 * np.pi, 721)
    rate = None if curve.rate is None else np.full(theta.size, curve.rate.centre_radps)
    values = curve(theta, rate)
    return {
        "method": curve.method.value,
        "order": curve.order,
        "noise_arcmin": curve.noise,
        "half_range_arcmin": float(np.ptp(values) / 2.0),
        "std_worst_arcmin": float(curve.std(theta, rate).max()),
        "held_out_rms_arcmin": None if curve.held_out is None else curve.held_out.rms,
        "coverage": curve.coverage.to_dict(),
        "remarks": list(curve.remarks),
    }


def _read(path: Path) -> Recording:
    """The recording, its angles checked to be degrees of one rotor in time order."""
    import numpy as np

    from highside.recording.table import read_recording

    table = read_recording(path)
    angle = table.require("rotor_deg")[0]
    back = np.flatnonzero(np.diff(table.t_s) < 0)
    if back.size:
        raise InputError(
            "time goes back", where=f"{path}: line {back[0] + 3}", field="t_s", remedy="sort the rows by time"
        )
    known = angle[np.isfinite(angle)]
    if known.size >= 8 and float(np.abs(known).max()) <= 2.0 * np.pi * 1.001 and float(np.ptp(known)) > 1.0:
        raise InputError(
            f"no angle is beyond {np.abs(known).max():.2f}: these are radians", where=str(path), field="rotor_deg",
            remedy="give degrees",
        )  # fmt: skip
    steps = np.abs(np.diff(known))
    if steps.size and float(steps.max()) > LARGEST_STEP_DEG:
        raise InputError(
            f"jumps by {steps.max():.0f} between two rows: no degrees (counts of an encoder?)", where=str(path),
            field="rotor_deg", remedy="give degrees",
        )  # fmt: skip
    turned = np.abs(np.mod(np.diff(known) + 180.0, 360.0) - 180.0)
    # a short table may step from pose to pose as it likes; a long recording is of a turning rotor
    if turned.size >= LONG_RECORDING and float(np.mean(turned > FAR_STEP_DEG)) > 0.3:
        raise InputError(
            f"many rows lie more than {FAR_STEP_DEG:g} deg from the row before: not in order, or sampled too slowly",
            where=str(path), field="rotor_deg", remedy="sort by time, or record faster",
        )  # fmt: skip
    return table


def _samples(table: Recording, with_rate: bool) -> list[tuple[str, Samples]]:
    """The errors that the recording has, each with the rows in which it and the angle are known."""
    import numpy as np

    from highside.rotation import Samples

    present = [channel for channel in CHANNELS if table.has(f"d_{channel}_arcmin")]
    if not present:
        raise InputError(
            f"has none of {', '.join(f'd_{channel}_arcmin' for channel in CHANNELS)}", where=table.source,
            remedy=f"it has: {', '.join(table.order)}",
        )  # fmt: skip
    names = [f"d_{channel}_arcmin" for channel in present]
    angle, *errors = table.require("rotor_deg", *names)
    rate = table.require("rotor_rate_dps")[0] if with_rate else None
    made: list[tuple[str, Samples]] = []
    for channel, name, error in zip(present, names, errors, strict=True):
        rows = np.isfinite(angle) & np.isfinite(error)
        if rate is not None:
            rows &= np.isfinite(rate)
        worst = float(np.abs(error[rows]).max()) if rows.any() else 0.0
        if worst > LARGEST_ERROR_ARCMIN:
            raise InputError(
                f"{worst:g} is no small error", where=table.source, field=name, remedy="give decoded - true in arcmin"
            )
        try:
            samples = Samples.build(
                np.radians(angle[rows]), error[rows], None if rate is None else np.radians(rate[rows])
            )
        except InputError as problem:
            raise InputError(problem.what, where=table.source, field=name, remedy=problem.remedy) from None
        made.append((channel, samples))
    return made


@app.command()
def compare(
    recording: RecordingArgument,
    rate_terms: Annotated[int, typer.Option(help="Powers of the rotor rate for polynomial9 and auto.")] = 0,
    network_input: Annotated[InputName, typer.Option(help="For the network.")] = InputName.SCALED,
    seed: Annotated[int, typer.Option(help="For the network: its first weights.")] = 0,
    html: PageOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fit all methods to the same rows: what each leaves, on whole turns it had not seen too, and relative to sine."""
    from highside.rotation import FitOptions, Method, NetworkInput
    from highside.rotation.compare import compare as compare_methods
    from highside.rotation.direction import direction_difference

    table = _read(recording)
    options = FitOptions(rate_terms, NetworkInput(network_input.value), seed)
    result: dict[str, Any] = {}
    compared: dict[str, tuple[Samples, Comparison]] = {}
    by_direction: dict[str, DirectionDifference | None] = {}
    for channel, samples in _samples(table, rate_terms > 0):
        comparison = compare_methods(samples, options=options)
        compared[channel] = samples, comparison
        best = comparison.scores.get(Method.AUTO) or next(iter(comparison.scores.values()), None)
        difference = None if best is None else direction_difference(samples, best.curve)
        by_direction[channel] = difference
        result[channel] = {
            "rows": samples.n,
            "mean_abs_before_arcmin": float(abs(samples.error).mean()),
            "methods": {
                method.value: {
                    "order": score.curve.order,
                    "mean_arcmin": score.mean,
                    "std_arcmin": score.std,
                    "mean_abs_arcmin": score.mean_abs,
                    "largest_arcmin": score.largest,
                    "held_out_rms_arcmin": None if score.curve.held_out is None else score.curve.held_out.rms,
                    "better_than_sine": comparison.better_than_sine(method),
                    "remarks": list(score.curve.remarks),
                }
                for method, score in comparison.scores.items()
            },
            "refused": {method.value: why for method, why in comparison.refused.items()},
            "direction": None if difference is None else difference.to_dict(),
        }
    if html is not None:
        from highside.recording.files import write_whole
        from highside.report.rotation_page import compare_page

        write_whole(html, compare_page(recording.name, compared).encode())
    if as_json:
        echo_json(json.dumps({"recording": str(recording), "channels": result}))
        return
    for channel, one in result.items():
        echo(f"{channel}: {one['rows']} rows, mean absolute error {one['mean_abs_before_arcmin']:.4f}'")
        echo(f"  {'method':<12} order  mean |e|    largest  held out  better than sine")
        for name, row in one["methods"].items():
            held = "-" if row["held_out_rms_arcmin"] is None else f"{row['held_out_rms_arcmin']:.5f}'"
            better = "-" if row["better_than_sine"] is None else f"{100 * row['better_than_sine']:.1f} %"
            echo(
                f"  {name:<12} {row['order']:>5}  {row['mean_abs_arcmin']:.5f}'  {row['largest_arcmin']:.4f}'"
                f"  {held:>9}  {better:>8}"
            )
        for name, why in one["refused"].items():
            echo(f"  {name}: {why}", err=True)
        told = by_direction[channel]
        echo("  one direction of rotation only" if told is None else f"  {told.sentence}")
