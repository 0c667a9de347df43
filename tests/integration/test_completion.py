"""Completion as bash does it: the script that is installed, asked by bash itself."""

from __future__ import annotations

import os
import shutil
import subprocess

import pytest
from daemon import HIGHSIDE

ASK = """
eval "$(_HIGHSIDE_COMPLETE=source_bash highside)"
complete -p highside
for line in "highside cal" "highside diagnose --mo" "highside calibrate so" "highside export --to "; do
  COMP_WORDS=($line); case "$line" in *" ") COMP_WORDS+=("");; esac
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
  _highside_completion highside
  echo "$line: ${COMPREPLY[*]}"
done
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_choices() -> None:
    path = f"{HIGHSIDE.parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "--norc", "-c", ASK], env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=200,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    first, *answers = done.stdout.splitlines()
    assert first.endswith("-F _highside_completion highside")
    said = dict(answer.split(":", 1) for answer in answers if ":" in answer)
    assert said["highside cal"].split() == ["calibrate"]
    assert said["highside diagnose --mo"].split() == ["--model"]
    assert said["highside calibrate so"].split() == ["solve"]
    assert {"csv", "parquet", "mcap"} <= set(said["highside export --to "].split())
