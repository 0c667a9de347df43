"""`highside rotation ...`: fit an error against the rotor angle, take it off, and compare the methods."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.options import Language, PrintLanguage, as_options, speaking
from highside.cli.say import echo, echo_json
from highside.cli.self_fit import fit_self
from highside.cli.turntable import turntable

if TYPE_CHECKING:
    from highside.api.rotation import CompensatedRecording, FitOfRotation
    from highside.rotation import Samples
    from highside.rotation.compare import CurveComparison
    from highside.rotation.direction import DirectionDifference

app = typer.Typer(
    name="rotation", no_args_is_help=True, help="Errors that repeat with the rotor angle: fit, apply, compare."
)

app.command()(turntable)
app.command("fit-self")(fit_self)


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
    language: Language = None,
    as_json: JsonOption = False,
) -> None:
    """Fit each error of a recording against the rotor angle and write a compensation."""
    from highside.api.rotation import fit_rotation

    with speaking(language):
        with as_options("rate_terms"):
            found = fit_rotation(
                recording,
                method=method.value,
                rate_terms=rate_terms,
                network_input=network_input.value,
                seed=seed,
                inclination_deg=inclination_deg,
                roll_deg=roll_deg,
                pitch_deg=pitch_deg,
            )
        _write_fit(found, output, html, method.value, as_json=as_json)


def _write_fit(found: FitOfRotation, output: Path, html: Path | None, method: str, *, as_json: bool) -> None:
    """Write the compensation and its page, and say what was fitted."""
    from highside.recording.files import write_whole
    from highside.words import _, told

    page = None
    if html is not None:
        from highside.report.rotation_page import fit_page

        page = fit_page(found.compensation, found.samples)
    write_whole(output, found.compensation.to_json().encode())
    if html is not None and page is not None:
        write_whole(html, page.encode())
    described, short = found.described(), found.compensation.id[:12]
    if as_json:
        echo_json(json.dumps({"output": str(output), "id": found.compensation.id, "curves": described}))
        return
    echo(_("%(file)s: %(method)s of %(rows)s rows, %(id)s", file=output, method=method, rows=found.rows, id=short))
    for name, one in described.items():
        line = _(
            "order %(order)s noise %(noise)s', amplitude %(size)s'",
            order=f"{one['order']:<2}",
            noise=f"{one['noise_arcmin']:.4f}",
            size=f"{one['half_range_arcmin']:.4f}",
        )
        if one["held_out_rms_arcmin"] is not None:
            line += ", " + _("held out %(size)s'", size=f"{one['held_out_rms_arcmin']:.4f}")
        echo(f"  {name:<8} {line}")
    for name, remark in found.remarks():
        echo(f"{name}: {told(remark, 'rotation')}", err=True)


@app.command()
def apply(
    compensation_file: Annotated[Path, typer.Argument(metavar="COMP", help="Compensation (JSON) of rotation fit.")],
    recording: RecordingArgument,
    output: Output,
    language: PrintLanguage = None,
    as_json: JsonOption = False,
) -> None:
    """Take the fitted errors off, of errors and of attitudes as the live service does.

    Of d_roll_arcmin, ... it makes d_roll_comp_arcmin, ... = measured - fitted. Of inc_deg, tf_deg (`calibrate apply`)
    and azi_deg (`drift`, which follows the sensors' package) it makes inc_comp_deg, tf_comp_deg, azi_comp_deg; to
    inc_std_deg, ... its own variance is added.
    """
    from highside.api.rotation import compensate

    with speaking(language):
        done = compensate(recording, compensation_file)
        done.data.write(output)
        _tell_compensated(done, output, as_json=as_json)


def _tell_compensated(done: CompensatedRecording[Any], output: Path, *, as_json: bool) -> None:
    from highside.words import _, told

    for warning in done.warnings:
        echo(_("warning: %(what)s", what=told(warning, "rotation")), err=True)
    if as_json:
        summary = {
            "output": str(output),
            "id": done.compensation.id,
            "rows": done.data.n,
            "channels": done.done.channels,
            "warning": done.warnings[0] if done.warnings else None,
            "warnings": list(done.warnings),
        }
        echo_json(json.dumps(summary | {"attitude": done.done.attitude}))
        return
    by = done.compensation.id[:12]
    echo(_("%(file)s: %(rows)s rows compensated by %(id)s", file=output, rows=done.data.n, id=by))
    for channel, one in done.done.channels.items():
        line = _(
            "mean absolute error %(before)s' -> %(after)s'",
            before=f"{one['before_mean_abs_arcmin']:.4f}",
            after=f"{one['after_mean_abs_arcmin']:.4f}",
        )
        echo(f"  {channel:<8} {line}")
    for name, counts in done.done.attitude.items():
        why = ", ".join(f"{n} {flag}" for flag, n in counts.items() if n and flag != "compensated")
        line = _("%(count)s rows compensated", count=counts["compensated"])
        echo(f"  {name:<8} {line}{f'; {why}' if why else ''}")


@app.command()
def compare(
    recording: RecordingArgument,
    rate_terms: Annotated[int, typer.Option(help="Powers of the rotor rate for polynomial9 and auto.")] = 0,
    network_input: Annotated[InputName, typer.Option(help="For the network.")] = InputName.SCALED,
    seed: Annotated[int, typer.Option(help="For the network: its first weights.")] = 0,
    html: PageOption = None,
    language: Language = None,
    as_json: JsonOption = False,
) -> None:
    """Fit all methods to the same rows: residuals, errors on whole turns not used by the fit, both relative to sine."""
    from highside.api.rotation import compare_rotation

    with speaking(language):
        with as_options("rate_terms"):
            found = compare_rotation(recording, rate_terms=rate_terms, network_input=network_input.value, seed=seed)
        if html is not None:
            from highside.recording.files import write_whole
            from highside.report.rotation_page import compare_page

            compared = {channel: (samples, comparison) for channel, (samples, comparison, _) in found.items()}
            write_whole(html, compare_page(recording.name, compared).encode())
        result = {channel: _compared(*one) for channel, one in found.items()}
        if as_json:
            echo_json(json.dumps({"recording": str(recording), "channels": result}))
            return
        for channel, one in result.items():
            _tell_compared(channel, one, found[channel][2])


def _compared(
    samples: Samples, comparison: CurveComparison, by_direction: DirectionDifference | None
) -> dict[str, Any]:
    """The methods of a channel, as `--json` prints them."""
    return {
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
        "direction": None if by_direction is None else by_direction.to_dict(),
    }


def _tell_compared(channel: str, one: dict[str, Any], by_direction: DirectionDifference | None) -> None:
    """The methods of a channel, side by side."""
    from highside.words import _, told

    size = f"{one['mean_abs_before_arcmin']:.4f}"
    echo(_("%(channel)s: %(rows)s rows, mean absolute error %(size)s'", channel=channel, rows=one["rows"], size=size))
    heads = [_("method"), _("order"), _("mean |e|"), _("largest"), _("held out"), _("better than sine")]
    rows = [
        [
            name,
            str(row["order"]),
            f"{row['mean_abs_arcmin']:.5f}'",
            f"{row['largest_arcmin']:.4f}'",
            "-" if row["held_out_rms_arcmin"] is None else f"{row['held_out_rms_arcmin']:.5f}'",
            "-" if row["better_than_sine"] is None else f"{100 * row['better_than_sine']:.1f} %",
        ]
        for name, row in one["methods"].items()
    ]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    for method, *figures in [heads, *rows]:
        places = (f"{figure:>{width}}" for figure, width in zip(figures, widths[1:], strict=True))
        echo(f"  {method:<{widths[0]}}  {'  '.join(places)}")
    for name, why in one["refused"].items():
        echo(f"  {name}: {told(why, 'rotation')}", err=True)
    way = _("one direction of rotation only") if by_direction is None else told(by_direction.sentence, "rotation")
    echo(f"  {way}")
