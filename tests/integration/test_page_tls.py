"""[web.tls]: what is wrong with a certificate or its key is one line, at `check` as at the start."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from page_pair import make_pair
from typer.testing import CliRunner

from highside.cli.main import app
from highside.config.web import WebTls
from highside.errors import InputError

HIGHSIDE = Path(sys.executable).parent / "highside"


def test_a_good_pair_is_taken(tmp_path: Path) -> None:
    made = make_pair(tmp_path).context()
    assert made.get_ciphers() and made.minimum_version.name == "TLSv1_2"


def wrong_pairs(folder: Path) -> dict[str, tuple[WebTls, str]]:
    good = make_pair(folder / "good")
    other = make_pair(folder / "other")
    garbage = folder / "garbage"
    garbage.write_bytes(b"\x00\xff not PEM")
    garbage.chmod(0o600)
    open_key = make_pair(folder / "open")
    open_key.key.chmod(0o644)
    return {
        "no certificate": (WebTls(certificate=folder / "none", key=good.key), "web.tls.certificate: no such file"),
        "no key": (WebTls(certificate=good.certificate, key=folder / "none"), "web.tls.key: no such file"),
        "not a certificate": (WebTls(certificate=garbage, key=good.key), "holds no certificate"),
        "not a key": (WebTls(certificate=good.certificate, key=garbage), "holds no private key"),
        "swapped": (WebTls(certificate=good.key, key=good.certificate), "web.tls.key: may be read by others"),
        "another's key": (WebTls(certificate=good.certificate, key=other.key), "web.tls.key: does not belong to"),
        "encrypted": (make_pair(folder / "locked", password=b"x"), "web.tls.key: is encrypted; decrypt it"),
        "expired": (make_pair(folder / "old", begins=-9, days=-2), "web.tls.certificate: has expired on 20"),
        "not yet": (make_pair(folder / "new", begins=2), "web.tls.certificate: is not valid before 20"),
        "open to all": (open_key, r"web.tls.key: may be read by others (mode 644); chmod 640"),
        "a directory": (WebTls(certificate=folder, key=good.key), "web.tls.certificate: is a directory"),
    }


def test_every_wrong_pair_is_named_in_one_line_by_check_and_by_the_session(tmp_path: Path) -> None:
    for name, (pair, said) in wrong_pairs(tmp_path).items():
        with pytest.raises(InputError) as caught:
            pair.context()
        assert said in str(caught.value), name
        config = tmp_path / "bench.toml"
        config.write_text(
            '[tool]\nid = "tool-7"\n[simulated]\n[plan]\nkind = "joint"\nposes = 16\n[web]\nport = 0\n[web.tls]\n'
            f'certificate = "{pair.certificate}"\nkey = "{pair.key}"\n'
        )
        answer = CliRunner().invoke(app, ["check", str(config)])
        assert isinstance(answer.exception, InputError) and said in str(answer.exception), name
    begun = subprocess.run(
        [HIGHSIDE, "calibrate", "bench", "--config", config, "--web", "--plain"],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert begun.returncode == 2 and said in begun.stderr and begun.stderr.count("\n") == 1, begun.stderr


def test_check_judges_a_bench_session(tmp_path: Path) -> None:
    config = tmp_path / "bench.toml"
    text = '[tool]\nid = "tool-7"\n[simulated]\n[plan]\nkind = "joint"\nposes = 16\n[web]\nhost = "0.0.0.0"\n'
    config.write_text(text)
    answer = CliRunner().invoke(app, ["check", str(config)])
    assert answer.exit_code == 0 and "good. A bench session: tool tool-7" in answer.output
    assert "travel in clear" in answer.output
    make_pair(tmp_path)
    config.write_text(f'{text}[web.tls]\ncertificate = "page.pem"\nkey = "page.key"\n')
    answer = CliRunner().invoke(app, ["check", str(config)])
    assert answer.exit_code == 0 and "page https://" in answer.output and "clear" not in answer.output
    (tmp_path / "token").write_text("a token of twenty letters")
    (tmp_path / "token").chmod(0o644)
    config.write_text(f'{text}token_file = "token"\n')
    answer = CliRunner().invoke(app, ["check", str(config)])
    assert isinstance(answer.exception, InputError) and "chmod 600" in str(answer.exception)
