"""Many recordings: diagnosed, solved or corrected on all processors or a cluster, and what they have in common.

An effect that is far too small for one recording is in all recordings of a lot. Each result row carries score and
information of every testable effect beside the base (`diagnosis.core.effect_scores`); they add up over the recordings
of a tool, and tools differ by what a random-effects model says (`pooling`). So a lot's common physics is found where
every single diagnosis says that nothing was left out.

The way in: `catalogue` says which recordings there are, `jobs` what is done with one of them, `parts` where a result
stands, `run` distributes (dask.distributed: the engine is not ours), `summary` reads the parts through DuckDB and asks
`pooling` and `common`; `page` is the report. Numerics in `pooling` and `common` are pure.
"""

__all__: list[str] = []
