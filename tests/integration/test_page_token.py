"""The token of a bench page is told once, to who started it, and to nobody else. A real page, asked as browsers do."""

from __future__ import annotations

import asyncio
import subprocess
from pathlib import Path

import httpx
import pytest
from bench_page import HIGHSIDE, bench_process

SECRET = "Zq8-token-never-to-be-seen"


async def what_the_page_says(folder: Path) -> dict[str, str]:
    """By what was asked: every way in, with the right token, a wrong one and none."""
    pages: dict[str, str] = {}
    async with bench_process(folder, more='token_file = "token"\n') as bench:
        assert bench.token == SECRET, "the start's own line gives it to who started it"
        async with httpx.AsyncClient(timeout=60.0) as client:
            asked = {
                "link": client.get(bench.link),
                "wrong token": client.get(f"{bench.address}?token={SECRET}x"),
                "form": client.post(f"{bench.address}login", data={"token": SECRET}),
                "no such page": client.get(f"{bench.address}none?token={SECRET}"),
                "onlooker": client.get(bench.address),
                "state": client.get(f"{bench.address}api/session/state"),
            }
            for name, ask in asked.items():
                answer = await ask
                assert answer.status_code < 500, name
                pages[name] = f"{answer.headers} {answer.text}"
            # the page of who has the cookie, too
            assert client.cookies, "the form let us in"
            pages["operator's page"] = (await client.get(bench.address)).text
        assert (await bench.command("pause", token=SECRET)).status_code in (200, 409)
        assert (await bench.command("pause", token=SECRET + "x")).status_code in (401, 403)
        await asyncio.sleep(1.0)
        bench.process.terminate()
        await bench.process.wait()
    return pages | {"what the process said": "".join(bench.said)}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_token_is_reported_once_and_nowhere_else(tmp_path: Path) -> None:
    """Not by what the process says later (right link, wrong token, commands, an address that is not there), by the
    page, by the session's state, in its files, by `check` or by `doctor`."""
    token_file = tmp_path / "token"
    token_file.write_text(SECRET + "\n")
    token_file.chmod(0o600)
    pages = asyncio.run(what_the_page_says(tmp_path))
    config = tmp_path / "bench.toml"
    for arguments in (["check", config], ["check", config, "--json"], ["doctor", "--config", config]):
        done = subprocess.run([HIGHSIDE, *arguments], capture_output=True, timeout=90, check=False, text=True)
        assert done.stdout + done.stderr
        pages[" ".join(map(str, arguments))] = done.stdout + done.stderr
    files = [path for path in tmp_path.rglob("*") if path.is_file() and path != token_file]
    assert len(files) > 1
    pages |= {str(path): path.read_bytes().decode(errors="replace") for path in files}
    assert [name for name, text in pages.items() if SECRET in text] == []
    token_file.write_text(SECRET[:5] + "\n")
    refused = subprocess.run([HIGHSIDE, "check", config], capture_output=True, timeout=90, check=False, text=True)
    assert refused.returncode != 0 and SECRET[:5] not in refused.stdout + refused.stderr
