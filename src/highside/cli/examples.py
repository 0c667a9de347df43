"""One example for each command, shown at the end of its `--help`. A test parses them, and runs those it can."""

from __future__ import annotations

import typer

EXAMPLES: dict[str, str] = {
    "simulate": "config/model-bench.toml -o session.csv.gz --poses poses.csv",
    "predict": "config/model-known.toml poses.csv -o predicted.csv",
    "decode": "session.hsw --codec tool -o session.csv.gz",
    "export": "session.csv.gz --to mcap",
    "import": "phone.csv -o session.csv.gz --units m/s2,rad/s --yes",
    "replay": "session.hsw --to pty --link /tmp/tool",
    "demo": "--seconds 20",
    "docs": "errors",
    "examples": "-o config",
    "detect": "--port /dev/ttyUSB0 --seconds 2",
    "doctor": "--config highside.toml",
    "init": "highside.toml",
    "run": "--config highside.toml --set mqtt.host=10.0.0.5",
    "serve": "--set mqtt.host=10.0.0.5",
    "check": "config/bench-simulated.toml",
    "schema": "",
    "fleet diagnose": "archive/ --model config/model-known.toml --out results",
    "fleet solve": "archive/ --method joint --out results",
    "fleet drift": "archive/ --method kinematic --out results",
    "fleet summary": "results --by lot --html fleet.html",
    "fleet archive": "--host 10.0.0.5 --out archive",
    "fleet records": "calibrations --html records.html",
    "effects": "",
    "effects new": "--from report/diagnosis.json --id my_effect -o effects",
    "confirm": "found.toml session2.csv.gz",
    "diagnose": "session.csv.gz --model config/model-known.toml --out report",
    "drift": "run.csv.gz --method kinematic --latitude-deg 52 -o drift.csv",
    "calibrate bench": "--config config/bench-simulated.toml --web",
    "calibrate sessions": "--config config/bench-simulated.toml",
    "calibrate poses": "session.csv.gz -o poses.csv",
    "calibrate solve": "poses.csv --method joint --tool tool-7 --store calibrations -o cal.json",
    "calibrate show": "cal.json",
    "calibrate apply": "cal.json session.csv.gz -o corrected.csv",
    "calibrate verify": "cal.json poses.csv --limit-inc-deg 0.1 --limit-tf-deg 1",
    "calibrate certificate": "cal.json --fields config/certificate.toml -o certificate.html",
    "calibrate iscwsa": "cal.json -o error-model.json",
    "calibrate activate": "cal.json --store calibrations",
    "calibrate history": "--store calibrations",
    "calibrate rollback": "--store calibrations --tool tool-7",
    "reproduce balance": "-o balance",
    "reproduce rotation": "-o rotation",
    "reproduce drift": "-o drift",
    "rotation fit": "turns.csv --method auto -o comp.json",
    "rotation fit-self": "run.csv.gz --of rotor -o comp.json",
    "rotation turntable": "turns.csv -o turntable.json",
    "rotation apply": "comp.json turns.csv -o corrected.csv",
    "rotation compare": "turns.csv --html compare.html",
    "keys new": 'lab.key --name "Laboratory"',
    "keys show": "lab.key.pub",
    "keys sign": "cal.json --key lab.key",
    "keys verify": "cal.json --trusted lab.key.pub",
    "surveys analyse": "surveys.jsonl --calibration cal.json --out surveys",
    "surveys list": "surveys.jsonl --depths depths.csv",
    "surveys export": "surveys.jsonl --to las -o surveys.las --depths depths.csv --azimuths gyro.csv",
    "toolface set": '12.5 --author "A. Driller" --config highside.toml',
    "toolface show": "--config highside.toml",
    "users add": '"K. Hansen" --role operate',
    "users list": "",
    "users password": '"K. Hansen"',
    "users role": '"K. Hansen" --role "put in force"',
    "users remove": '"K. Hansen"',
    "users acts": "",
    "watch recording": "run.csv.gz --calibration cal.json --out watch",
    "watch propose": "watch/watch.json --calibration cal.json -o proposed.json",
}
"""Arguments by command; files are named as the examples of other commands make them, and those of `config/`."""


def attach(app: typer.Typer) -> None:
    """Put the examples below the help of all commands of `app` and its groups."""
    groups = [(group, str(group.name or _typer(group).info.name)) for group in app.registered_groups]
    for group, name in groups:
        group.epilog = _example(name) or group.epilog  # a group that does something by itself
    for commands, prefix in [(app, ""), *((_typer(group), f"{name} ") for group, name in groups)]:
        for command in commands.registered_commands:
            name = command.name or getattr(command.callback, "__name__", "").replace("_", "-")
            command.epilog = _example(prefix + name) or command.epilog


def _example(command: str) -> str | None:
    arguments = EXAMPLES.get(command)
    return None if arguments is None else f"Example: `highside {command} {arguments}".rstrip() + "`"


def _typer(group: typer.models.TyperInfo) -> typer.Typer:
    assert group.typer_instance is not None
    return group.typer_instance
