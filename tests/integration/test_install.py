"""The package as others install it: the wheel of a used checkout, in fresh environments.

With the core dependencies alone, the newest and the oldest that are allowed; with each extra; with all extras, the
oldest; with each extra alone, the oldest (`make oldest`; of the service always). The locks say nothing of these: who
runs `pip install` gets what the bounds allow.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import urllib.error
import urllib.parse
import urllib.request
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from broker import free_port

from tests.few_poses import model_of_few_poses

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

USED = (
    "config/state/calibrations/records/a.json",
    "config/my.toml",
    "state/outbox.sqlite",
    "session.csv.gz",
    "cal.json",
)
"""What a user may have left in a checkout."""
NO_REGISTRY = re.compile(r"failed to fetch|dns error|error sending request|connection (refused|reset)", re.IGNORECASE)
FURTHER = pytest.mark.further
FORBIDDEN_ON_A_TOOL = ("nicegui", "fastapi", "numba", "llvmlite", "matplotlib", "bokeh", "pyarrow", "pandas")


def uv(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run uv. Where the registry of packages is out of reach: skipped, but a failure under CI."""
    program = Path(sys.executable).with_name("uv")
    found = program if program.is_file() else shutil.which("uv")
    assert found, "the tests need uv (the extra test)"
    done = subprocess.run([found, "--quiet", *arguments], capture_output=True, text=True, timeout=600)
    if done.returncode != 0 and NO_REGISTRY.search(done.stderr) and os.environ.get("CI") != "true":
        pytest.skip("needs a registry of packages within reach")
    assert done.returncode == 0, done.stderr
    return done


@dataclass(frozen=True)
class Installed:
    """A fresh environment with the package in it."""

    folder: Path

    def highside(self, *arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        command = [self.folder / "bin" / "highside", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=cwd)

    def python(self, declared: str) -> str:
        done = subprocess.run(
            [self.folder / "bin" / "python", "-c", declared], capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def has(self, module: str) -> bool:
        return self.python(f"from importlib.util import find_spec; print(find_spec({module!r}) is not None)") == "True"

    def refuses(self, *arguments: str | Path, says: str, cwd: Path | None = None) -> None:
        """One line on the error output, exit status 2, nothing else."""
        done = self.highside(*arguments, cwd=cwd)
        assert done.returncode == 2, done.stderr
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert done.stderr.startswith("highside: ")
        assert says in done.stderr
        assert done.stdout == ""


@pytest.fixture(scope="session")
def wheel(project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a checkout that was used."""
    copy = tmp_path_factory.mktemp("checkout") / "highside"
    left_out = shutil.ignore_patterns("__pycache__", "state")
    for name in ("src", "config", "docs", "systemd", ".ci"):
        shutil.copytree(project_root / name, copy / name, ignore=left_out)
    for name in (
        "pyproject.toml",
        "hatch_build.py",
        "README.md",
        "Makefile",
        ".gitignore",
        "requirements-core.lock",
        "requirements.lock",
        "requirements-test.lock",
    ):
        shutil.copy(project_root / name, copy / name)
    for name in ("LICENSE", "NOTICE"):
        shutil.copy(project_root / name, copy / name)
    for name in USED:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_text("of a user")
    # the site as `make docs` leaves it there for a wheel
    site = [sys.executable, project_root / "docs" / "site" / "build.py", "--to", copy / "src" / "highside" / "site"]
    subprocess.run(site, check=True, capture_output=True, timeout=200)
    out = copy.parent / "dist"
    # with the hatchling of this environment: nothing is fetched to build
    uv("build", "--wheel", "--sdist", "--no-build-isolation", "--python", sys.executable, "--out-dir", out, copy)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="session")
def install(
    wheel: Path, project_root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, str], Installed]:
    """Install the wheel with an extra ("" for none) at a resolution; environments are kept for the whole run."""
    made: dict[tuple[str, str], Installed] = {}

    def install(extra: str, resolution: str) -> Installed:
        if (extra, resolution) not in made:
            folder = tmp_path_factory.mktemp("environment") / "venv"
            uv("venv", "--python", sys.executable, folder)
            python = folder / "bin" / "python"
            # from the project's own file: of a wheel, which is one direct requirement, the oldest would be the wheel
            pins = folder / "pins.txt"
            extras = ["--extra", extra] if extra else []
            resolved = ["--resolution", resolution, "--python", sys.executable, "--no-header", *extras, "-o", pins]
            uv("pip", "compile", *resolved, project_root / "pyproject.toml")
            uv("pip", "install", "--python", python, "--requirement", pins)
            uv("pip", "install", "--python", python, "--no-deps", wheel)
            uv("pip", "check", "--python", python)
            made[extra, resolution] = Installed(folder)
        return made[extra, resolution]

    return install


@pytest.fixture(scope="session", params=["highest", "lowest-direct"])
def core(request: pytest.FixtureRequest, install: Callable[[str, str], Installed]) -> Installed:
    """The core dependencies alone, the newest and the oldest that are allowed."""
    return install("", request.param)


@pytest.fixture(scope="session")
def bench_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated session of the bench: session.csv and poses.csv."""
    folder = tmp_path_factory.mktemp("bench")
    highside = Path(sys.executable).with_name("highside")
    model = model_of_few_poses(folder / "model.toml")
    made = [highside, "simulate", model, "-o", folder / "session.csv", "--poses", folder / "poses.csv"]
    subprocess.run(made, check=True, capture_output=True, timeout=120)
    solve = ["calibrate", "solve", folder / "poses.csv", "--method", "joint", "--tool", "bench-1"]
    subprocess.run([highside, *solve, "-o", folder / "cal.json"], check=True, capture_output=True, timeout=120)
    return folder


# --- what is in it ---------------------------------------------------------------------------------------------------


def test_a_wheel_of_a_used_checkout_holds_nothing_of_its_user(wheel: Path, project_root: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    shipped = {name for name in names if name.startswith("highside/data/config/")}
    here = subprocess.run(["git", "ls-files", "config"], cwd=project_root, capture_output=True, text=True)
    examples = here.stdout.split() or [f"config/{name}" for name in ("highside.dbc", "bench.toml", "highside.toml")]
    assert shipped >= {f"highside/data/{name}" for name in examples}, "a new example must be named in pyproject.toml"
    assert len(shipped) == len(examples) or not here.stdout
    for name in ("LICENSE", "NOTICE"):
        assert any(found.endswith(f".dist-info/licenses/{name}") for found in names), "the wheel carries its licence"
    for name in USED:
        assert not any(Path(found).name == Path(name).name for found in names), name
    sources = subprocess.run(
        [sys.executable, "-m", "tarfile", "-l", next(wheel.parent.glob("*.tar.gz"))], capture_output=True, text=True
    ).stdout
    assert "pyproject.toml" in sources
    for name in USED:
        assert name not in sources, name


def test_the_unit_installs_what_a_tool_needs(project_root: Path) -> None:
    assert "pip install '.[service]'" in (project_root / "systemd" / "highside.service").read_text()


def test_nothing_holds_the_parser_of_the_command_line_back(project_root: Path) -> None:
    declared = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]
    wanted = [
        *declared["dependencies"],
        *(name for extra in declared["optional-dependencies"].values() for name in extra),
    ]
    assert not [name for name in wanted if re.match(r"(amqtt|passlib|click)\b", name)]


# --- the core alone --------------------------------------------------------------------------------------------------


def test_the_core_starts(core: Installed) -> None:
    assert core.highside("--version").stdout.strip() == core.python("import highside; print(highside.__version__)")
    # the help of every command, in one process
    core.python(
        "import typer\n"
        "from highside.cli.main import app\n"
        "def walk(command, words):\n"
        "    assert app([*words, '--help'], standalone_mode=False) == 0, words\n"
        "    for name, below in getattr(command, 'commands', {}).items():\n"
        "        walk(below, [*words, name])\n"
        "walk(typer.main.get_command(app), [])\n"
    )
    assert "a [codec] table" in " ".join(core.highside("decode", "--help").stdout.split())


def test_the_core_shows_the_documentation_that_the_wheel_carries(core: Installed) -> None:
    """The pages of the navigation, what they load, and the index of the search, from the installed package alone."""
    process = subprocess.Popen(
        [core.folder / "bin" / "highside", "docs", "errors", "--no-browser"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        first = process.stdout.readline().split()[0]
        own = first.removesuffix("reference/errors.html")
        waiting, found, words = {first, own + "search.json"}, set(), ""
        while waiting and len(found) < 400:
            address = waiting.pop()
            with urllib.request.urlopen(address, timeout=30) as response:
                assert response.status == 200
                body = response.read()
            found.add(address)
            if not address.endswith(".html"):
                words = body.decode() if address.endswith("search.json") else words
                continue
            for name in re.findall(rb'(?:src|href)="?([^" >#?]+)', body):
                linked = urllib.parse.urljoin(address, name.decode())
                if linked.startswith(own) and linked not in found and not linked.endswith("/"):
                    waiting.add(linked)
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()
    assert len([address for address in found if address.endswith(".html")]) > 50
    assert any(address.endswith(".css") for address in found) and any(address.endswith(".js") for address in found)
    assert "rotor" in words and "toolface" in words


def test_wrong_use_of_the_core_is_one_line(core: Installed, tmp_path: Path) -> None:
    core.refuses("rnu", says="No such command 'rnu'. Did you mean 'run'? (see highside --help)")
    core.refuses("run", says="Missing option '--config'. (see highside run --help)")
    core.refuses("demo", "--secnods", "3", says="--secnods")
    core.refuses("demo", "--seconds", "x", says="'--seconds'")
    core.refuses("run", "--config", "nope.toml", says="nope.toml", cwd=tmp_path)
    (tmp_path / "odd.toml").write_text('[tool]\nid = "a"\n[link]\nkind = "serial"\nprot = "x"\n')
    core.refuses("check", "odd.toml", says="link", cwd=tmp_path)


def test_the_demo_of_the_core(core: Installed) -> None:
    done = core.highside("demo", "--seconds", "4", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["lost"] == 0
    assert found["published"] > 10
    assert found["inc_error_rms_deg"] < 0.02


def test_the_core_at_the_desk(core: Installed, project_root: Path, bench_data: Path, tmp_path: Path) -> None:
    def works(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        done = core.highside(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done

    poses, model = bench_data / "poses.csv", project_root / "config" / "model-known.toml"
    works("calibrate", "solve", poses, "--method", "joint", "--tool", "bench-1", "--store", "cals", "-o", "cal.json")
    works("calibrate", "activate", "cal.json", "--store", "cals")
    works("calibrate", "apply", "cal.json", bench_data / "session.csv", "-o", "corrected.csv")
    # the answer and its page, whose pictures need no matplotlib
    works("diagnose", poses, "--model", model, "--out", "report")
    assert json.loads((tmp_path / "report" / "diagnosis.json").read_text())["verdict"] == "named"
    page = (tmp_path / "report" / "report.html").read_text()
    assert "base_tilt" in page
    assert page.count("<svg") >= 3


def test_what_the_core_lacks_is_said_before_the_work(
    core: Installed, project_root: Path, bench_data: Path, tmp_path: Path
) -> None:
    session, record = bench_data / "session.csv", bench_data / "cal.json"
    plot = "pip install 'highside[plot]'"
    core.refuses("calibrate", "certificate", record, "-o", "cert.html", says=plot, cwd=tmp_path)
    core.refuses("export", session, "--to", "parquet", says="highside[export]", cwd=tmp_path)
    core.refuses("export", session, "--to", "mcap", says="highside[export]", cwd=tmp_path)
    (tmp_path / "x.h5").write_bytes(b"\x89HDF\r\n\x1a\n and nothing")
    core.refuses("import", "x.h5", "-o", "out.csv", says="pip install 'highside[import]'", cwd=tmp_path)
    (tmp_path / "x.h5").unlink()
    core.refuses("keys", "new", "my.key", "--name", "me", says="pip install 'highside[sign]'", cwd=tmp_path)
    bench = project_root / "config" / "bench-simulated.toml"
    core.refuses("calibrate", "bench", "--config", bench, "--auto", "--web", says="highside[web]", cwd=tmp_path)
    for paper in ("balance", "rotation", "drift"):
        began = time.monotonic()
        core.refuses("reproduce", paper, says=plot, cwd=tmp_path)
        assert time.monotonic() - began < 20.0, "the experiment of minutes was run first"
    assert sorted(tmp_path.iterdir()) == [], "something was half-written"


# --- each extra ------------------------------------------------------------------------------------------------------


def reads_a_dbc(it: Installed, _root: Path, _data: Path, folder: Path) -> None:
    (folder / "bus.log").write_text("".join(f"({k}.000000) can0 123#{k:02x}00\n" for k in range(1, 9)))
    (folder / "other.dbc").write_text(
        'VERSION ""\nBU_: X\nBO_ 291 Accel: 2 X\n SG_ Along : 0|16@1- (0.001,0) [-10|10] "g" X\n'
    )
    fields = "".join(f'a{axis}_g = {{ signal = "Accel.Along" }}\n' for axis in "xyz")
    (folder / "map.toml").write_text(f'[codec]\nname = "dbc"\ndbc = "other.dbc"\n[codec.fields]\n{fields}')
    done = it.highside("decode", "bus.log", "--codec", "dbc", "--config", "map.toml", "-o", "out.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert len((folder / "out.csv").read_text().splitlines()) >= 9


def draws(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    done = it.highside("calibrate", "certificate", data / "cal.json", "-o", folder / "cert.html")
    assert done.returncode == 0, done.stderr
    assert "<svg" in (folder / "cert.html").read_text()


def prints(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    done = it.highside("calibrate", "certificate", data / "cal.json", "-o", folder / "cert.pdf")
    assert done.returncode == 0, done.stderr
    assert (folder / "cert.pdf").read_bytes().startswith(b"%PDF-")


def serves_the_bench(it: Installed, root: Path, _data: Path, folder: Path) -> None:
    port = free_port()
    plan = 'plan={kind="joint",poses=8}'
    sets = [plan, f"web.port={port}", f"store.directory={folder}/cals", f"store.sessions={folder}/sessions"]
    options = [word for item in sets for word in ("--set", item)]
    command = [it.folder / "bin" / "highside", "calibrate", "bench", "--web", "--plain"]
    command += ["--config", root / "config" / "bench-simulated.toml", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as bench:
        page = answer(f"http://127.0.0.1:{port}/", bench)
        bench.send_signal(signal.SIGINT)
        said, _ = bench.communicate(timeout=60)
    assert "<html" in page.lower()
    assert "Traceback" not in said


def serves_figures(it: Installed, _root: Path, _data: Path, folder: Path) -> None:
    port = free_port()
    (folder / "tool.toml").write_text(
        '[tool]\nid = "install-test"\n[link]\nkind = "serial"\nport = "/dev/no-such-port"\nwait_at_start = true\n'
        f'[codec]\nname = "tool"\n[mqtt]\nport = {free_port()}\n[metrics]\nport = {port}\n'
        '[service]\nstate_dir = "state"\n'
    )
    command = [it.folder / "bin" / "highside", "run", "--config", folder / "tool.toml"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as service:
        figures = answer(f"http://127.0.0.1:{port}/metrics", service)
        service.send_signal(signal.SIGTERM)
        said, _ = service.communicate(timeout=30)
    assert "highside_" in figures
    assert service.returncode == 0, said


def exports(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    shutil.copy(data / "session.csv", folder / "session.csv")
    for kind in ("mcap", "parquet"):
        done = it.highside("export", "session.csv", "--to", kind, cwd=folder)
        assert done.returncode == 0, done.stderr
        assert (folder / f"session.{kind}").stat().st_size > 1000


def lists_surveys(it: Installed, _root: Path, _data: Path, folder: Path) -> None:
    kept = {"t": 1.79e9, "g_total": 1.0, "tf_deg": 10.0, "cal_id": "c1", "accepted": True, "reasons": []}
    lines = [kept | {"seq": k, "inc_deg": 2.0 * k, "azi_deg": 30.0 + k, "md_m": 30.0 * k} for k in range(5)]
    (folder / "surveys.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for kind in ("las", "witsml"):
        done = it.highside("surveys", "export", "surveys.jsonl", "--to", kind, "-o", f"list.{kind}", cwd=folder)
        assert done.returncode == 0, done.stderr
        assert "120" in (folder / f"list.{kind}").read_text()


def imports(it: Installed, _root: Path, _data: Path, folder: Path) -> None:
    it.python(
        "import numpy as np, openpyxl, h5py\n"
        f"folder = {str(folder)!r}\n"
        "book = openpyxl.Workbook()\n"
        "rows = [(k / 100, 0.0, 0.0, 9.8) for k in range(20)]\n"
        "for row in [('time_s', 'acc_x_mps2', 'acc_y_mps2', 'acc_z_mps2'), *rows]: book.active.append(row)\n"
        "book.save(folder + '/x.xlsx')\n"
        "with h5py.File(folder + '/x.h5', 'w') as file:\n"
        "    file['time_s'], file['acc_mps2'] = np.array(rows)[:, 0], np.array(rows)[:, 1:]\n"
    )
    for name in ("x.xlsx", "x.h5"):
        done = it.highside("import", name, "-o", "out.csv", cwd=folder)
        assert done.returncode == 0, done.stderr
    (folder / "x.bag").write_bytes(b"#ROSBAG V2.0\n and nothing")
    (folder / "x.ulg").write_bytes(b"ULog\x01\x12\x35\x01 and nothing")
    for name in ("x.bag", "x.ulg"):
        done = it.highside("import", name, "-o", "out.csv", cwd=folder)
        assert done.returncode == 2
        assert "is a damaged" in done.stderr or "holds no topic" in done.stderr, done.stderr


def takes_frames(it: Installed, _root: Path, _data: Path, _folder: Path) -> None:
    # neither pandas nor polars comes along, who calls has them; what only speaks Arrow needs pyarrow beside
    assert it.has("narwhals")
    said = it.python(
        "import highside\n"
        "class Streamed:\n"
        "    def __arrow_c_stream__(self, requested_schema=None): raise AssertionError\n"
        "try:\n"
        "    highside.read(Streamed())\n"
        "except highside.InputError as error:\n"
        "    print(error)\n"
    )
    assert said == "this needs pyarrow, which is not installed; pip install 'highside[export]'"


def shows_plots(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    it.python(
        "import highside\n"
        f"poses = highside.find_poses({str(data / 'session.csv')!r})\n"
        "plot = highside.calibrate(poses, tool='t').plot()\n"
        f"plot.save({str(folder / 'plot.html')!r})\n"
        f"plot.save({str(folder / 'plot.svg')!r})\n"
        "assert plot._repr_html_().startswith('<iframe')\n"
    )
    assert 100_000 < (folder / "plot.html").stat().st_size < 1_000_000
    assert it.has("narwhals")


def brings_no_pandas(it: Installed, _root: Path, _data: Path, _folder: Path) -> None:
    assert not it.has("pandas")


def signs(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    shutil.copy(data / "cal.json", folder / "cal.json")
    for words in (
        ("new", "my.key", "--name", "me"),
        ("sign", "cal.json", "--key", "my.key"),
        ("verify", "cal.json", "--trusted", "my.key.pub"),
    ):
        done = it.highside("keys", *words, cwd=folder)
        assert done.returncode == 0, done.stderr


def compiles(it: Installed, _root: Path, data: Path, folder: Path) -> None:
    assert it.python("from highside.attitude import compiled; print(compiled.wanted(10**7))") == "True"
    done = it.highside("calibrate", "apply", data / "cal.json", data / "session.csv", "-o", folder / "out.csv")
    assert done.returncode == 0, done.stderr


def answer(url: str, process: subprocess.Popen[str], timeout_s: float = 120.0) -> str:
    """What a server says as soon as it listens."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        assert process.poll() is None, process.communicate()[0]
        try:
            return str(urllib.request.urlopen(url, timeout=10).read().decode())
        except urllib.error.HTTPError as error:
            return str(error.read().decode())
        except OSError:
            time.sleep(0.1)
    process.kill()
    raise AssertionError(f"{url} does not answer: {process.communicate()[0]}")


def sums_up_a_fleet(it: Installed, root: Path, data: Path, folder: Path) -> None:
    (folder / "lot").mkdir()
    for tool in ("one", "two"):
        shutil.copy(data / "poses.csv", folder / "lot" / f"{tool}.csv")
    model = root / "config" / "model-known.toml"
    run = ("fleet", "diagnose", folder / "lot", "--model", model, "--out", folder / "out", "--workers", "1", "--json")
    done = it.highside(*run)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    # one content under two names has one result
    assert (counts["recordings"], counts["failed"]) == (2, 0)
    done = it.highside("fleet", "summary", folder / "out", "--json", "--html", folder / "fleet.html")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["repeated"] == 1


Does = Callable[[Installed, Path, Path, Path], None]
EXTRAS: dict[str, tuple[Does, ...]] = {
    "can": (reads_a_dbc,),
    "plot": (draws,),
    "pdf": (draws, prints),
    "web": (serves_the_bench, draws),
    "metrics": (serves_figures,),
    "export": (exports,),
    "import": (imports, exports),
    "frames": (takes_frames,),
    "notebook": (shows_plots, draws, brings_no_pandas),
    "sign": (signs,),
    "survey": (lists_surveys,),
    "fast": (compiles,),
    "fleet": (sums_up_a_fleet,),
    "service": (reads_a_dbc, serves_figures, signs),
}


OLDEST = tuple(EXTRAS) if os.environ.get("HIGHSIDE_OLDEST") == "each" else ("service",)
"""Extras that are tried alone at the oldest versions they allow: what goes onto a tool, and each by `make oldest`."""


def test_each_extra_is_tried(project_root: Path) -> None:
    declared = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    # those are no part of the product: the tests themselves, the site's builder, the build, the benchmarks' rivals
    assert set(EXTRAS) == set(declared) - {"all", "test", "docs", "build", "rivals"}
    tried = test_an_extra_brings_what_it_promises.pytestmark[0].args[1]
    assert {one if isinstance(one, str) else one.values[0] for one in tried} == set(EXTRAS)


def _try_extra(extra: str, it: Installed, project_root: Path, bench_data: Path, tmp_path: Path) -> None:
    """Everything that the extra promises, each in a folder of its own."""
    for number, does in enumerate(EXTRAS[extra]):
        (tmp_path / str(number)).mkdir()
        does(it, project_root, bench_data, tmp_path / str(number))


@pytest.mark.parametrize(
    "extra",
    [
        "can",
        pytest.param("plot", marks=FURTHER),
        pytest.param("pdf", marks=FURTHER),
        "web",
        "metrics",
        "export",
        pytest.param("import", marks=FURTHER),
        "frames",
        pytest.param("notebook", marks=FURTHER),
        "sign",
        pytest.param("survey", marks=FURTHER),
        "fast",
        pytest.param("fleet", marks=FURTHER),
        "service",
    ],
)
def test_an_extra_brings_what_it_promises(
    extra: str, install: Callable[[str, str], Installed], project_root: Path, bench_data: Path, tmp_path: Path
) -> None:
    _try_extra(extra, install(extra, "highest"), project_root, bench_data, tmp_path)


@pytest.mark.parametrize("extra", OLDEST)
def test_an_extra_alone_at_its_oldest_brings_what_it_promises(
    extra: str, install: Callable[[str, str], Installed], project_root: Path, bench_data: Path, tmp_path: Path
) -> None:
    """Beside others, an extra has what those require of the packages they share; here it has its own bounds alone."""
    _try_extra(extra, install(extra, "lowest-direct"), project_root, bench_data, tmp_path)


def test_the_service_brings_nothing_of_the_desk(install: Callable[[str, str], Installed]) -> None:
    it = install("service", "highest")
    assert [name for name in FORBIDDEN_ON_A_TOOL if it.has(name)] == []


@pytest.fixture
def everything_oldest(install: Callable[[str, str], Installed]) -> Installed:
    return install("all", "lowest-direct")


@pytest.mark.parametrize(
    "does",
    [
        reads_a_dbc,
        pytest.param(draws, marks=FURTHER),
        pytest.param(prints, marks=FURTHER),
        serves_figures,
        exports,
        imports,
        shows_plots,
        signs,
        compiles,
        pytest.param(sums_up_a_fleet, marks=FURTHER),
    ],
)
def test_all_extras_at_their_oldest(
    does: Does, everything_oldest: Installed, project_root: Path, bench_data: Path, tmp_path: Path
) -> None:
    does(everything_oldest, project_root, bench_data, tmp_path)


def test_the_bench_page_at_its_oldest(everything_oldest: Installed, project_root: Path, tmp_path: Path) -> None:
    serves_the_bench(everything_oldest, project_root, tmp_path, tmp_path)
