"""Groups of laws that are alike: of as many columns, on the same channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

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
    keep: bool = False
    """whether all columns are kept once they are made"""
    _kept: list[Array] = field(default_factory=list)
    """(G m, c, n) all columns; empty before they were made"""

    def raw_blocks(self, n: int) -> Iterator[Array]:
        """(g m, c, n) columns of a few groups at a time, on the channels that they act on; each may be where the
        last was."""
        count, size = self.orders.shape
        at_once = min(max(1, LAW_EVIDENCE.at_once // size), count)
        if self._kept:
            for i in range(0, count, at_once):
                yield self._kept[0][i * size : (i + at_once) * size]
            return
        room = np.empty(((count if self.keep else at_once) * size, len(self.channels), n))
        for i in range(0, count, at_once):
            groups, start = self.groups[i : i + at_once], i * size if self.keep else 0
            out = room[start : start + len(groups) * size]
            if self._of_one_place:
                self._together(groups, out)
            else:
                for k, group in enumerate(groups):
                    group.columns(out[k * size : (k + 1) * size])
            yield out
        if self.keep:
            self._kept.append(room)

    @cached_property
    def _of_one_place(self) -> bool:
        """Whether every group is functions in one place, all of which are multiplied at once."""
        return all(type(group) is LawGroup and len(group.units) == 1 for group in self.groups)

    def _together(self, groups: list[LawGroup], out: Array) -> None:
        functions = np.array([group.basis[0] for group in groups])
        fields = np.array([group.units[0].field for group in groups])[:, None, list(self.channels)]
        np.multiply(functions[:, :, None], fields, out=out.reshape(*functions.shape[:2], *out.shape[1:]))
