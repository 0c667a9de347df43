"""Inner products of many columns beside noises that do not mix channels, once for each shape of a channel's noise.

Noise of a channel that is larger by a factor divides every inner product there by its square, and noise of another
channel changes none. So of all noises of a search, few of whose shapes differ, the columns go through few filters. The
rest are sums over channels of what is known.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.family import Family
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.on_channels_policy import ON_CHANNELS
from highside.diagnosis.laws.policy import LAW_EVIDENCE


@dataclass
class _OneShape:
    """What is known of one channel under one shape of its noise, at the size that it had in this noise."""

    whitener: Whitener
    grams: list[Array] = field(default_factory=list)
    """(G, m, m) of each family on the channel; empty before the first pass"""
    across: dict[Hashable, tuple[Array, list[Array]]] = field(default_factory=dict)
    """raw rows (K, C, n) by their key, and (G, m, K) of each family on the channel; of rows without anything there
    none"""

    def forget(self, needed: Mapping[Hashable, Array]) -> None:
        """Drops what was kept first, but for what is needed, while more numbers are kept than there is room for."""
        sizes = {key: sum(one.size for one in parts) for key, (_, parts) in self.across.items()}
        excess = sum(sizes.values()) - LAW_EVIDENCE.kept // ON_CHANNELS.part
        for key in [one for one in self.across if one not in needed]:
            if excess <= 0:
                return
            excess -= sizes[key]
            del self.across[key]


@dataclass
class _Job:
    """What a pass finds of one channel."""

    shape: _OneShape
    rows: Array
    """(K, n) whitened; where the columns are not, through the transposed filter as well"""
    lacking: list[Hashable]
    first: bool
    products: list[Array] = field(default_factory=list)
    """(G, m, K) of each family on the channel"""
    grams: list[Array] = field(default_factory=list)


class OnChannels:
    """The columns of some families, channel by channel."""

    def __init__(self, families: Sequence[Family]) -> None:
        self.families = families
        self._shapes: dict[int, list[_OneShape]] = {}

    def beside(
        self, whitener: Whitener, rows: Mapping[Hashable, Array]
    ) -> tuple[list[Array], dict[Hashable, list[Array]]]:
        """(G, m, m) inner products of each family under a noise, and (G, m, K) of them with raw rows (K, C, n), by the
        keys of these: the same rows have the same key."""
        channels = sorted({c for family in self.families for c in family.channels})
        shapes = {c: self._shape(c, whitener) for c in channels}
        jobs = {c: self._job(c, shape, rows) for c, shape in shapes.items()}
        self._pass({c: job for c, job in jobs.items() if job.first or job.lacking})
        for c, job in jobs.items():
            job.shape.across.update({key: (rows[key], []) for key in rows if key not in job.shape.across})
            ends = np.cumsum([len(rows[key]) for key in job.lacking])[:-1]
            parted = [np.split(one, ends, axis=2) for one in job.products] if job.lacking else []
            for i, key in enumerate(job.lacking):
                job.shape.across[key] = rows[key], [one[i] for one in parted]
            job.shape.grams = job.grams if job.first else job.shape.grams
            shapes[c].forget(rows)
        scales = {c: float(s.whitener.noise.factor[c] / whitener.noise.factor[c]) ** 2 for c, s in shapes.items()}
        grams = self._summed({c: shape.grams for c, shape in shapes.items()}, scales)
        across = {}
        for key, raw in rows.items():
            known = {c: parts for c, shape in shapes.items() if (parts := shape.across[key][1])}
            across[key] = self._summed(known, scales, len(raw))
        return grams, across

    def products(self, whitener: Whitener, white: Array) -> list[Array]:
        """(G, m, K) inner products of each family with whitened rows (K, C, n); they are not kept."""
        jobs = {}
        for c in sorted({c for family in self.families for c in family.channels}):
            rows = whitener.transposed_channel(c, white[:, c])
            jobs[c] = _Job(_OneShape(whitener), rows, [], first=False)
        self._pass(jobs)
        return self._summed({c: job.products for c, job in jobs.items()}, dict.fromkeys(jobs, 1.0))

    def _shape(self, c: int, whitener: Whitener) -> _OneShape:
        known = self._shapes.setdefault(c, [])
        for i, one in enumerate(known):
            if one.whitener.of_shape(c, whitener):
                # the one used last stays longest
                known.append(known.pop(i))
                return one
        del known[: max(0, len(known) - ON_CHANNELS.shapes + 1)]
        known.append(_OneShape(whitener))
        return known[-1]

    def _job(self, c: int, shape: _OneShape, rows: Mapping[Hashable, Array]) -> _Job:
        lacking = [key for key in rows if key not in shape.across and np.any(rows[key][:, c])]
        first = not shape.grams
        raw = [rows[key][:, c] for key in lacking]
        whitener = shape.whitener
        white = whitener.channel(c, np.concatenate(raw)) if raw else np.empty((0, whitener.problem.n))
        return _Job(shape, white if first or not raw else whitener.transposed_channel(c, white), lacking, first)

    def _pass(self, jobs: Mapping[int, _Job]) -> None:
        for family in self.families:
            here = [(k, c) for k, c in enumerate(family.channels) if c in jobs]
            if not here:
                continue
            size = family.orders.shape[1]
            grams: dict[int, list[Array]] = {c: [] for _, c in here}
            products: dict[int, list[Array]] = {c: [] for _, c in here}
            for block in family.raw_blocks(jobs[here[0][1]].shape.whitener.problem.n):
                for k, c in here:
                    job, columns = jobs[c], block[:, k]
                    if job.first:
                        columns = job.shape.whitener.channel(c, columns)
                        own = columns.reshape(-1, size, columns.shape[1])
                        grams[c].append(own @ own.transpose(0, 2, 1))
                    products[c].append((columns @ job.rows.T).reshape(-1, size, len(job.rows)))
            for _, c in here:
                jobs[c].products.append(np.concatenate(products[c]))
                if jobs[c].first:
                    jobs[c].grams.append(np.concatenate(grams[c]))

    def _summed(self, known: Mapping[int, Sequence[Array]], scales: Mapping[int, float], width: int = 0) -> list[Array]:
        """Of each family the sum over those of its channels that are known; (G, m, width) zeros where none is."""
        next_of = {c: iter(parts) for c, parts in known.items()}
        made = []
        for family in self.families:
            parts = [(scales[c], next(next_of[c])) for c in family.channels if c in known]
            made.append(sum_of(parts) if parts else np.zeros((*family.orders.shape, width)))
        return made


def sum_of(parts: Sequence[tuple[float, Array]]) -> Array:
    """The sum of arrays with factors."""
    scale, first = parts[0]
    whole = first if scale == 1.0 else scale * first
    for scale, other in parts[1:]:
        whole = whole + scale * other
    return np.asarray(whole)
