"""`highside reproduce balance`: one instrument, found from table 1 as `diagnose --summary` finds it, predicts all."""

from __future__ import annotations

import csv
import inspect
import json
import pickle
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from highside.cli.main import main
from highside.diagnosis.table.engine import diagnose_summary
from highside.papers import balance_prediction, published_instrument, reproduce_balance
from highside.papers.balance_prediction import Count
from highside.papers.balance_session import COLUMNS, INCLINATIONS_DEG, METHODS

FURTHER = pytest.mark.further

FILES = {
    "table1": "table1_conventional.csv",
    "table2": "table2_small_conventional_vs_balance.csv",
    "table3": "table3_large_conventional_vs_balance.csv",
    "table4": "table4_topologies_1p206.csv",
    "table5": "table5_topologies_0p612.csv",
    "table6": "table6_average.csv",
}
pytestmark = pytest.mark.timeout(1800)
"""The command takes a minute of a processor, and much longer where others share that."""
HIGHSIDE = [sys.executable, "-c", "from highside.cli.main import main; main()"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("reproduce") / "new"
    done = subprocess.run(
        [*HIGHSIDE, "reproduce", "balance", "--json", "-o", str(folder)],
        capture_output=True, text=True, check=True, cwd=folder.parent,
    )  # fmt: skip
    assert done.stdout.count("\n") == 1
    return folder, json.loads(done.stdout)


@pytest.fixture(scope="module")
def table1_alone(run: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    """What is found from table 1, without a model."""
    result: dict[str, Any] = run[1]["instrument"]["diagnosis"]
    return result


def test_the_numbers_kept_are_the_published_ones(shared_data: Path) -> None:
    kept = published_instrument.published()
    assert set(kept) == set(FILES)
    for table, name in FILES.items():
        with (shared_data / "paper_balance" / name).open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(kept[table])
        for row, ours in zip(rows, kept[table], strict=True):
            assert list(row) == list(ours)
            for column, text in row.items():
                if column in ("correction", "triple"):
                    assert ours[column] == text
                else:
                    assert ours[column] == (float(text) if text else None)


class AskedError(Exception):
    """Raised in place of an answer."""


def test_the_question_is_the_one_that_diagnose_asks_of_table_1(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, with the same seed and nothing else known; the answer takes a minute and is asked for once."""
    asked: list[dict[str, Any]] = []

    def note(*arguments: object, **options: object) -> None:
        of = inspect.signature(diagnose_summary).bind(*arguments, **options)
        of.apply_defaults()
        asked.append({name: value for name, value in of.arguments.items() if name != "progress"})
        raise AskedError

    monkeypatch.setattr("highside.diagnosis.table.engine.diagnose_summary", note)
    monkeypatch.setattr("highside.papers.published_instrument.diagnose_summary", note)
    table = shared_data / "paper_balance" / FILES["table1"]
    command = ["highside", "diagnose", "--summary", str(table), "--corrected-by", "conventional3"]
    monkeypatch.setattr(sys, "argv", [*command, "--out", str(tmp_path / "out")])
    with pytest.raises((AskedError, SystemExit)):
        main()
    with pytest.raises(AskedError):
        published_instrument.from_table_1(published_instrument.published()["table1"])
    by_command, by_reproduce = asked
    assert (
        by_command.keys() == by_reproduce.keys() == inspect.signature(diagnose_summary).parameters.keys() - {"progress"}
    )
    for name, value in by_command.items():
        assert pickle.dumps(value) == pickle.dumps(by_reproduce[name]), name


@FURTHER
def test_the_instrument_is_the_one_that_table_1_alone_gives(
    run: tuple[Path, dict[str, Any]], table1_alone: dict[str, Any]
) -> None:
    part = run[1]["instrument"]
    assert part["found_from"] == "table 1"
    for claim in table1_alone["claims"]:
        for name, parameter in claim["parameters"].items():
            assert part["named"][claim["effect"]][name] == parameter["value"]
    assert part["noise_g"] == table1_alone["noise"]["reading_noise_g"]


def test_there_is_no_second_instrument(run: tuple[Path, dict[str, Any]]) -> None:
    assert not {"bench", "published_instrument"} & set(run[1])
    assert not hasattr(reproduce_balance, "INSTRUMENT") and not hasattr(reproduce_balance, "BENCH")
    assert "ours" not in json.dumps(run[1]["tables"])
    assert abs(sum(e["probability"] for e in run[1]["instrument"]["explanations"]) - 1.0) < 1e-6


def test_every_table_and_column_has_published_predicted_interval_and_covered(run: tuple[Path, dict[str, Any]]) -> None:
    kept, tables = published_instrument.published(), run[1]["tables"]
    assert list(tables) == list(FILES)
    for table, rows in tables.items():
        assert len(rows) == len(kept[table])
        for row, source in zip(rows, kept[table], strict=True):
            assert row["held_out"] == (row["correction"] != "conventional")
            refused = row["inc_ref_deg"] == 90.0 and row["held_out"]
            assert (row["predicted"] is None) == refused
            for column in COLUMNS:
                assert row["published"][column] == source[column]
                if refused or source[column] is None:
                    assert row["covered"][column] is None
                    continue
                low, middle, high = (row[k][column] for k in ("low", "predicted", "high"))
                assert low < middle < high
                assert row["covered"][column] == (low <= source[column] <= high)


def test_each_held_out_figure_counts_once_and_each_column_has_a_verdict(run: tuple[Path, dict[str, Any]]) -> None:
    part = run[1]["coverage"]
    # table 6 without 90 deg; tables 4 and 5; of tables 2 and 3 what stands nowhere else and is not lost
    assert part["of"] == 40 + 32 + 7 + 9
    assert sum(c["of"] for c in part["by_column"].values()) == part["of"]
    assert sum(c["covered"] for c in part["by_column"].values()) == part["covered"]
    assert part["expected"] == pytest.approx(0.95 * part["of"])
    assert {(row["table"], row["column"]) for row in part["by_table"]} == {
        (table, column) for table in list(FILES)[1:] for column in COLUMNS
    }
    assert {row["verdict"] for row in part["by_table"]} <= {
        "predicted", "predicted in part", "not predicted", "nothing to predict",
    }  # fmt: skip
    assert part["simulated"]["instruments"] >= 50
    # measured on the published tables; far below, the prediction is broken
    assert part["covered"] > 0.6 * part["of"]


def test_verdicts_follow_the_counts() -> None:
    assert Count("t", "c", 10, 10).verdict == "predicted"
    assert Count("t", "c", 9, 10).verdict == "predicted"
    assert Count("t", "c", 6, 10).verdict == "predicted in part"
    assert Count("t", "c", 4, 10).verdict == "not predicted"
    assert Count("t", "c", 0, 0).verdict == "nothing to predict"


def test_other_numbers_in_the_held_out_tables_change_no_prediction() -> None:
    """What is found takes table 1 alone (`from_table_1`); what is predicted does not look at what was published."""
    from highside.diagnosis.table.posterior import Drawn
    from highside.physics.forward import ForwardModel

    model = ForwardModel.of({"bias": {"b_x": 3e-4}, "base_tilt": {"tilt_x": 2e-4}})
    ensemble = balance_prediction.run_ensemble([Drawn(model, 3e-5, np.zeros((3, 3)), ())] * 20, 1)
    tables = published_instrument.published()
    other = {
        name: [{k: v + 1.0 if k in COLUMNS and v is not None else v for k, v in row.items()} for row in rows]
        for name, rows in tables.items()
    }
    first, second = (balance_prediction.predict(ensemble, t) for t in (tables, other))
    assert [c.predicted for c in first.cells] == [c.predicted for c in second.cells]
    assert first.overall.covered > second.overall.covered == 0


def test_the_mean_toolface_of_a_triple_follows_from_the_means_of_inclination(run: tuple[Path, dict[str, Any]]) -> None:
    part = run[1]["triples"]
    # of arcs of 0.003 deg: the paper counts T and its errors as this project does
    assert part["rms_arc_deg"]["signs_as_here"] < 1.5e-4
    assert part["rms_arc_deg"]["toolface_the_other_way"] > 20 * part["rms_arc_deg"]["signs_as_here"]
    assert len(part["closures"]) == 4
    assert set(part["arc_of_1-2-3_deg"]) == {"3.006", "1.998", "1.206", "0.612"}


def test_the_same_holds_on_any_simulated_instrument() -> None:
    """The rule of the triples is geometry: it holds with the signs of `gravity_direction`, to second order."""
    from highside.papers.balance_session import INCLINATIONS_DEG, PaperPlan, cells_of, run_session
    from highside.papers.balance_triples import BEFORE
    from highside.physics.forward import ForwardModel

    model = ForwardModel.of({"encoder_first_harmonic": {"c1": 2e-3, "s1": -1e-3}, "bias": {"b_x": 5e-4}})
    cells = cells_of(run_session(PaperPlan.of_the_paper(), model, 0.0, np.random.default_rng(1)).errors_deg())
    row = INCLINATIONS_DEG.index(1.206)
    less = {m: cells[METHODS.index(m), row] - cells[METHODS.index("average"), row] for m in METHODS[1:5]}
    for triple, other in BEFORE.items():
        expected = less[other][0] / np.sin(np.radians(1.206))
        # second order: a twentieth of the largest; with the other sign it would be off by 0.04 and more
        assert less[triple][2] == pytest.approx(expected, abs=4e-3)
        assert abs(less[triple][2]) > 0.015


def test_the_published_instrument_is_diagnosed(table1_alone: dict[str, Any]) -> None:
    assert table1_alone["verdict"] in ("named", "named_plus")
    classes = [set(claim["equivalence_class"]) for claim in table1_alone["claims"]]
    # near vertical only a bench that is not level explains means and peak-to-peaks of both angles
    assert any("base_tilt" in names for names in classes)
    # the toolface that runs with cos I has several names
    assert any({"reference_twist", "cross_product"} <= names for names in classes)
    assert any("a station at" in claim["next_manoeuvre"] for claim in table1_alone["claims"])
    assert table1_alone["fit"]["unit"] == "sigma"
    assert table1_alone["fit"]["heldout_rmse_after"] < 0.6 * table1_alone["fit"]["heldout_rmse_before"]
    assert table1_alone["fit"]["heldout_gain_low"] > 0
    assert "1.998 deg" in " ".join(table1_alone["remainder"]["hints"])


def test_where_model_and_measurement_part_is_said_from_the_numbers(run: tuple[Path, dict[str, Any]]) -> None:
    said = {s["topic"]: s for s in run[1]["statements"]}
    for topic in (
        "Conventional: peak-to-peak of inclination",
        "Conventional: mean of inclination",
        "Conventional: mean of toolface",
        "Average balance: inclination",
        "Small inclinations are as good as large ones",
    ):
        assert not said[topic]["holds_published"]
        assert not said[topic]["holds_predicted"]
    grown = said["All errors fall"]
    assert not grown["holds_published"]
    assert "mean T at 59.994 deg (2.9 times)" in grown["published"]
    assert "mean I at 45 deg in table 3 (6.5 times)" in grown["published"]
    assert "1.6 % and 28.1 %" in said["What is left of toolface errors (mean, peak-to-peak)"]["published"]
    assert "refused" in run[1]["refused"][0]
    shares = {row["inc_ref_deg"]: row["after"]["published"] for row in run[1]["specification_share_percent"][1:]}
    assert (round(shares[1.206], 1), round(shares[0.612], 1)) == (9.0, 19.7)


def test_the_bench_is_not_the_truth(run: tuple[Path, dict[str, Any]]) -> None:
    row = next(r for r in run[1]["against_truth_deg"] if r["inc_ref_deg"] == 0.612)
    assert row["average_tf_rms_truth_deg"] > 2.0 * row["average_tf_rms_bench_deg"]
    assert row["joint_tf_rms_truth_deg"] < 0.5 * row["average_tf_rms_truth_deg"]


class Collector(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href"):
                self.links.append(value or "")


def test_the_page_stands_alone_and_says_what_the_json_says(run: tuple[Path, dict[str, Any]]) -> None:
    folder, printed = run
    assert sorted(path.name for path in folder.iterdir()) == ["balance.html", "balance.json"]
    assert json.loads((folder / "balance.json").read_text()) == printed
    page = (folder / "balance.html").read_text()
    found = Collector()
    found.feed(page)
    assert found.tags.count("svg") == 14  # seven figures of the paper (four in two parts), tables 1 and 6, the triples
    assert found.tags.count("table") == 12
    for number in range(1, 8):
        assert f"Figure {number}." in page
    for number in range(1, 7):
        assert f"Table {number}." in page
    assert f"{printed['coverage']['covered']} of {printed['coverage']['of']} cells of tables 2 to 6" in page
    # nothing is fetched: links point into the page, and to ids that exist once
    assert all(link.startswith("#") for link in found.links)
    assert {link[1:] for link in found.links} <= set(found.ids)
    assert len(set(found.ids)) == len(found.ids)
    assert "<script" not in page
    assert not re.search(r"url\((?!#)", page)
    assert "currentColor" in page


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = subprocess.run(
        [*HIGHSIDE, "reproduce", "balance", "-o", str(tmp_path / "file" / "x")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot be made a folder" in done.stderr


def test_an_interval_holds_its_share_and_a_refused_row_counts_nothing() -> None:
    values = np.random.default_rng(1).normal(size=(100_000, 1))
    low, middle, high = balance_prediction.interval(values)
    assert abs(float(middle[0])) < 0.02
    inside = np.mean((values > low) & (values < high))
    assert inside >= 0.949


def test_peak_to_peaks_are_widened_by_what_they_need_and_never_negative() -> None:
    """Means held 95 % at 1.4, p-p T 88 %: each column has its own width."""
    drawn = np.random.default_rng(2).normal(0.1, 0.1, (400, 6, 11, 4))
    nothing = np.zeros((400, 6, 11, 73), dtype=np.float32)
    ensemble = balance_prediction.Ensemble(drawn, nothing, nothing)
    middle, top = np.quantile(drawn[:, METHODS.index("average"), INCLINATIONS_DEG.index(1.206)], [0.5, 0.975], axis=0)
    found = [
        cell
        for cell in balance_prediction.predict(ensemble, published_instrument.published()).cells
        if (cell.table, cell.correction, cell.inc_ref_deg) == ("table6", "average", 1.206)
    ]
    assert [cell.column for cell in found] == list(COLUMNS)
    for k, cell in enumerate(found):
        assert cell.low is not None and cell.high is not None
        share = (cell.high - middle[k]) / (top[k] - middle[k])
        assert share == pytest.approx((1.4, 1.6, 1.4, 2.3)[k], rel=1e-4)
        assert ("_pp_" in cell.column) is (cell.low > -1e-6)
