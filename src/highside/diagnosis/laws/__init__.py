"""Laws found from readings that no effect of the library explains. The way in is not built yet; this is its place.

An unnamed interaction is located by `core.location` and told as covariates. A law goes further: a short formula in
these covariates, found on some stretches, proved on others and compared with the library, which can then be written
as an effect and diagnosed by name. It stands beside the kinds of recordings and may use `core` alone.
"""

from __future__ import annotations

__all__: list[str] = []
