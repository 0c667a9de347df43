"""What is wrong at the moment, since when, and the detail that helps to find it."""

from __future__ import annotations

from collections.abc import Iterator

from highside.bench.session.reasons import Fault


class Faults:
    """A set of faults; the time is given by `now_s`."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._found: dict[Fault, tuple[float, str]] = {}

    def put(self, fault: Fault, detail: str = "") -> None:
        """It is there (still); the newest detail counts, the first time stays."""
        since = self._found[fault][0] if fault in self._found else self.now_s
        self._found[fault] = (since, detail)

    def clear(self, *faults: Fault) -> None:
        for fault in faults:
            self._found.pop(fault, None)

    def set(self, fault: Fault, wrong: bool, detail: str = "") -> None:
        if wrong:
            self.put(fault, detail)
        else:
            self.clear(fault)

    def __contains__(self, fault: Fault) -> bool:
        return fault in self._found

    def __iter__(self) -> Iterator[tuple[Fault, float, str]]:
        """Fault, time at which it began, detail."""
        for fault, (since, detail) in self._found.items():
            yield fault, since, detail
