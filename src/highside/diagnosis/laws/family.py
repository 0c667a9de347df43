"""Groups of laws that are alike: of as many columns, on the same channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.policy import LAW_EVIDENCE


@dataclass(frozen=True)
class Family:
    """Groups of the same number of columns on the same channels."""

    members: list[int]
    """their numbers among all groups"""
    channels: tuple[int, ...]
    orders: Array
    """(G, m)"""
    groups: list[LawGroup]
    tries: Array
    """(G,) logarithm of how many like it are tried"""

    def raw_blocks(self, n: int) -> Iterator[Array]:
        """(g m, c, n) columns of a few groups at a time, on the channels that they act on; each is where the last
        was."""
        count, size = self.orders.shape
        at_once = min(max(1, LAW_EVIDENCE.at_once // size), count)
        room = np.empty((at_once * size, len(self.channels), n))
        for i in range(0, count, at_once):
            groups = self.groups[i : i + at_once]
            for k, group in enumerate(groups):
                group.columns(room[k * size : (k + 1) * size])
            yield room[: len(groups) * size]
