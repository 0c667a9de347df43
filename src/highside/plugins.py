"""What other installed packages add: effects, codecs and calibration methods, found through their entry points.

A package names what it adds in its own metadata,

    [project.entry-points."highside.codecs"]
    witmotion = "rig_sensors.witmotion:CODEC"

and every command finds it, with nothing edited here. A package that cannot be loaded must not stop those who do not
use it: it is omitted with one line that says why, and only what requests it by name is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from highside.printable import one_line


@dataclass(frozen=True, slots=True)
class Plugin:
    """One entry point: the `name` it states, the package (`source`) that states it, and what it stands for (`value`),
    or `fault`: why there is none."""

    name: str
    source: str
    value: Any = None
    fault: str = ""

    def refused(self, fault: str) -> Plugin:
        """The same, found unfit."""
        return Plugin(self.name, self.source, None, fault)

    def __str__(self) -> str:
        return f"{self.name!r} of the installed package {self.source}"


@cache
def plugins(group: str) -> tuple[Plugin, ...]:
    """What installed packages add to a `group` ("highside.codecs"), by name; one that fails to load has its `fault`."""
    found = []
    for point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        source = "of no name" if point.dist is None else f"{point.dist.name} {point.dist.version}"
        try:
            found.append(Plugin(point.name, source, point.load()))
        except (Exception, SystemExit) as error:
            # it is another's code, run at import: whatever it raises is the reason why it is omitted
            found.append(Plugin(point.name, source, None, f"{type(error).__name__}: {one_line(str(error))}"))
    return tuple(found)
