"""The pages of each person at three widths, and the cable pulled at each: what they are made of is as it is kept."""

from __future__ import annotations

import json
import os

from people_walk import KEPT, Skeleton, differences, masked, walked


async def test_each_person_finds_their_pages_as_they_are_kept() -> None:
    (walk,) = await walked("chromium", brief=True)
    assert walk.faults == []
    assert walk.looked > 50 and walk.cut > 20
    if os.environ.get("HIGHSIDE_RENEW_PICTURES"):
        lines = [f" {json.dumps(where)}: {json.dumps(seen)}" for where, seen in sorted(walk.seen.items())]
        KEPT.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    assert differences(json.loads(KEPT.read_text()), walk.seen) == [], "look at the pages, then: make pictures"


def test_what_moved_is_gone_or_came_is_a_difference() -> None:
    kept: dict[str, Skeleton] = {"page, 320": masked([["h1", "Tool 7 of 9", [0.1, 0.9]], ["button", "Go", None]])}
    for other, said in (
        ([["h1", "Tool 12 of 4", [0.12, 0.9]], ["button", "Go", None]], 0),
        ([["h1", "Tool 7 of 9", [0.1, 0.98]], ["button", "Go", None]], 1),
        ([["h1", "Tool 7 of 9", [0.1, 0.9]]], 1),
        ([["h1", "Tool 7 of 9", [0.1, 0.9]], ["button", "Stop", None]], 1),
    ):
        assert len(differences(kept, {"page, 320": masked(other)})) == said  # type: ignore[arg-type]
    assert differences(kept, {}) == ["page, 320: is missing"]
