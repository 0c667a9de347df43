"""What another session says of a law: confirmed, not confirmed, not varied; sessions of a generator of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import highside
from highside.cli.main import app
from highside.errors import InputError

Array = NDArray[np.float64]

LEAN = {
    "slug": "offset_y_tf", "place": "offset", "channels": ["y"], "formula": "exp(-((tf - 130) / 20)^2 / 2)",
    "coefficients": [[3e-4]],
    "axes": [{"covariate": "tf", "low": 0.0, "high": 360.0, "functions": [["dent", 130.0, 20.0]]}],
}  # fmt: skip
WARM = {
    "slug": "scale_x_temp", "place": "scale", "channels": ["x"], "formula": "",
    "coefficients": [[0.0, 4e-4]],
    "axes": [{"covariate": "temp", "low": 20.0, "high": 60.0, "functions": [["cosine", 1], ["cosine", 2]]}],
}  # fmt: skip
MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}, "laws": [LEAN, WARM]}


def gravity(inc: Array, tf: Array) -> Array:
    return np.stack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])


def session(
    seed: int, *, dent: float = 3e-4, warm: float = 4e-4, ramp_c: float = 30.0, walk: float = 0.0
) -> dict[str, Array]:
    """Poses in random order, four rows each, of a sensor of its own with a dent at one toolface and a scale factor that
    bends with the temperature."""
    rng = np.random.default_rng(seed)
    inc, tf = np.meshgrid(
        np.radians([10.0, 35, 60, 85, 110]), np.radians(np.arange(0, 360, 20.0) + seed), indexing="ij"
    )
    order = rng.permutation(inc.size)
    inc, tf = np.repeat(inc.ravel()[order], 4), np.repeat(tf.ravel()[order], 4)
    n = inc.size
    temp = 25 + ramp_c * np.sin(np.pi * np.arange(n) / n) ** 2
    f = gravity(inc, tf)
    reading = f + 1e-3 * rng.standard_normal((3, 3)) @ f + 2e-3 * rng.standard_normal((3, 1))
    apart = (np.degrees(tf) - 130 + 180) % 360 - 180
    reading[1] += dent * np.exp(-0.5 * (apart / 20) ** 2)
    reading[0] += warm * np.cos(2 * np.pi * (temp - 20) / 40) * f[0]
    reading += 8e-5 * rng.standard_normal((3, n)) + walk * np.cumsum(rng.standard_normal((3, n)), axis=1)
    return {
        "t_s": 5.0 * np.arange(n), "ax_g": reading[0], "ay_g": reading[1], "az_g": reading[2],
        "inc_ref_deg": np.degrees(inc), "tf_ref_deg": np.degrees(tf) % 360, "temp_c": temp,
        "pose": np.repeat(np.arange(n // 4), 4).astype(float),
    }  # fmt: skip


def verdicts(done: highside.Confirmation) -> dict[str, str]:
    return {claim.claim: claim.verdict for claim in done.claims}


def test_what_is_there_again_is_confirmed_with_its_share() -> None:
    inside = 0
    for seed in range(1, 9):
        done = highside.confirm(MODEL, session(seed))
        assert verdicts(done) == {"law:offset_y_tf": "confirmed", "law:scale_x_temp": "confirmed"}
        assert done.confirmed
        inside += sum(claim.low <= 1 <= claim.high for claim in done.claims)
        assert all(claim.high - claim.low < 0.5 and claim.visited == 1.0 for claim in done.claims)
    # 16 intervals of 95 %
    assert inside >= 13


def test_what_is_not_there_is_not_confirmed_and_half_of_it_is_reported_as_half() -> None:
    done = highside.confirm(MODEL, session(3, dent=0.0))
    assert verdicts(done) == {"law:offset_y_tf": "not_confirmed", "law:scale_x_temp": "confirmed"}
    assert not done.confirmed
    (half, _) = highside.confirm(MODEL, session(3, dent=0.9e-4)).claims
    assert half.verdict == "not_confirmed" and half.low < 0.3 < half.high


def test_a_session_at_one_temperature_says_nothing_of_what_follows_it() -> None:
    done = highside.confirm(MODEL, session(4, ramp_c=0.0))
    assert verdicts(done) == {"law:offset_y_tf": "confirmed", "law:scale_x_temp": "not_varied"}


def test_an_offset_that_walks_widens_the_interval() -> None:
    quiet, rough = (highside.confirm(MODEL, session(5, walk=walk)).claims[0] for walk in (0.0, 4e-5))
    assert rough.high - rough.low > 1.5 * (quiet.high - quiet.low)
    assert rough.verdict in ("confirmed", "not_varied")


def test_what_lies_beyond_the_range_is_said() -> None:
    claim = highside.confirm(MODEL, session(6, ramp_c=60.0)).claims[1]
    assert 0.5 < claim.visited < 0.95
    assert f"{100 * (1 - claim.visited):.0f} % of the rows lie beyond" in claim.in_words()


def test_an_effect_of_the_model_is_confirmed_too() -> None:
    model = {**MODEL, "effects": {"included": ["quadratic"], "quadratic": {"k2_x": 5e-4}}, "laws": []}
    rows = session(7, dent=0.0, warm=0.0)
    there = {**rows, "ax_g": rows["ax_g"] + 5e-4 * rows["ax_g"] ** 2}
    assert verdicts(highside.confirm(model, there)) == {"quadratic": "confirmed"}
    assert verdicts(highside.confirm(model, rows)) == {"quadratic": "not_confirmed"}


@pytest.mark.parametrize(
    ("model", "columns", "what"),
    [
        ({"laws": []}, {}, "holds no law and no effect to confirm"),
        ({"laws": [LEAN], "reference": {"kind": "magnitude"}}, {}, "reference attitude"),
        (MODEL, {"ax_g": None}, "lacks the column ax_g"),
        (MODEL, {"tf_ref_deg": None}, "tf_ref_deg"),
        ({"laws": [{**LEAN, "axes": [{**LEAN["axes"][0], "covariate": "mud_bar"}]}]}, {}, "mud_bar"),  # type: ignore[index]
    ],
)
def test_what_cannot_be_confirmed_is_one_line(model: dict[str, Any], columns: dict[str, None], what: str) -> None:
    rows = {name: column for name, column in session(1).items() if name not in columns}
    with pytest.raises(InputError) as refused:
        highside.confirm(model, rows)
    assert what in str(refused.value) and "\n" not in str(refused.value)


def test_the_command_says_it_in_words_and_by_its_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from highside.config.model import as_toml, parse_model

    found = tmp_path / "found.toml"
    found.write_text(as_toml(parse_model(MODEL, where="model")))
    highside.Recording(session(1)).write(tmp_path / "same.csv")
    highside.Recording(session(2, dent=0.0, ramp_c=0.0)).write(tmp_path / "other.csv")
    assert app(["confirm", str(found), str(tmp_path / "same.csv")], standalone_mode=False) in (None, 0)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("law:offset_y_tf (") and ": confirmed, " in first and ": confirmed, " in second
    assert app(["confirm", str(found), str(tmp_path / "other.csv"), "--json"], standalone_mode=False) == 1
    report = json.loads(capsys.readouterr().out)
    assert [claim["verdict"] for claim in report["claims"]] == ["not_confirmed", "not_varied"]
    assert report["claims"][1]["share"] is None
