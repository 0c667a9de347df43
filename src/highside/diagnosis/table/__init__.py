"""Published error tables: means and peak-to-peaks after a correction. The way in is `engine.diagnose_summary`.

The correction was made on the same bench, from poses of its own, and hides or changes what is looked for; so the
whole procedure is simulated (`chain`), with common random draws, as a peak-to-peak is no linear function. Sets of
effects are fitted by maximum likelihood (`fit`) and searched by a beam (`search`); `explained` is the best set and
its rivals, `posterior` keeps what the table leaves open as draws, `instrument` predicts other tables, `advice` says
which inclination to measure next.
"""

from __future__ import annotations

__all__ = ["chain", "engine", "policy"]
"""the ways in: modules, loaded when they are used"""
