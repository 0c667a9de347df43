"""The reproduction of the balance paper as plain values for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from highside.papers import published_instrument
from highside.papers.balance_statements import statements
from highside.papers.reproduce_balance import Reproduction


def figures(found: Reproduction) -> dict[str, dict[str, Any]]:
    """What each of the paper's figures shows beside what is predicted of it: from which tables, and the verdicts."""
    predictions = found.instrument.predictions

    def counted(table: str, methods: tuple[str, ...] = ()) -> dict[str, Any]:
        own = [c for c in predictions.cells if c.table == table and c.held_out and c.covered is not None]
        own = [c for c in own if not methods or c.correction in methods]
        return {"table": table, "covered": sum(bool(c.covered) for c in own), "of": len(own)}

    result: dict[str, dict[str, Any]] = {
        "figure1": {"shows": "conventional errors over a turn", "table": "table1", "held_out": False},
        "figure2": {
            "shows": "small inclinations, conventional and balance 1-2-3",
            "held_out": True,
            **counted("table2"),
        },
        "figure3": {
            "shows": "large inclinations, conventional and balance of three quadrants",
            "held_out": True,
            **counted("table3"),
        },
    }
    for name, table, inc in (("figure4", "table4", "1.206"), ("figure5", "table5", "0.612")):
        likely = [row["probability_largest_there"] for row in found.omitted[inc]]
        result[name] = {
            "shows": f"the four triples at {inc} deg",
            "held_out": True,
            **counted(table),
            "error_largest_in_omitted_quadrant": {"published": True, "probability": likely},
        }
    result["figure6"] = {"shows": "average of the four triples", "held_out": True, **counted("table6")}
    parts = [row[name] for row in found.ratios for name in ("d_inc_pp_deg", "d_tf_pp_deg")]
    parts += [row["after"] for row in found.shares if "after" in row]
    result["figure7"] = {
        "shows": "peak-to-peak after as a share of before, and of the specification",
        "held_out": True,
        "covered": sum(bool(p["covered"]) for p in parts),
        "of": len(parts),
    }
    return result


def as_dict(found: Reproduction) -> dict[str, Any]:
    """Everything as plain values for JSON."""
    return {
        **published_instrument.as_dict(found.instrument),
        "tables": found.tables,
        "figures": figures(found),
        "ratios_percent": found.ratios,
        "specification_share_percent": found.shares,
        "omitted_quadrants": found.omitted,
        "against_truth_deg": found.truth,
        "refused": found.refused,
        "statements": [asdict(s) for s in statements(found)],
    }
