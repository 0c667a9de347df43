"""Another maker's axes and signs, mapped once, at the codec's edge.

A map is written as three signed letters: which maker's axis gives the tool's x, y and z. `"xyz"` changes nothing,
`"-yxz"` reads tool x = -maker y, tool y = maker x, tool z = maker z. The tool frame is right-handed with z along the
tool axis up-hole; a map that turns a right-handed sensor into a left-handed tool (a mirror) is refused unless it is
requested, because it makes every toolface run backwards and passes every test of |g|.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TypeVar

from highside.errors import InputError

_TERM = re.compile(r"([+-]?)([xyz])")
V = TypeVar("V", float, float | None)


@dataclass(frozen=True, slots=True)
class AxisMap:
    """A signed permutation: tool axis i is `signs[i]` times maker's axis `order[i]`."""

    order: tuple[int, int, int] = (0, 1, 2)
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @classmethod
    def parse(cls, text: str, *, allow_mirror: bool = False) -> AxisMap:
        """Read a map such as `"xyz"` or `"+x-y-z"`. Raises InputError that says what is wrong with it."""
        terms = _TERM.findall(text)
        if "".join(sign + letter for sign, letter in terms) != text or sorted(t[1] for t in terms) != ["x", "y", "z"]:
            raise InputError(
                f"{text!r} is no axis map",
                field="axes",
                remedy='name x, y, z once each, with a sign where negative, as "-yxz"',
            )
        order = tuple("xyz".index(letter) for _, letter in terms)
        signs = tuple(-1.0 if sign == "-" else 1.0 for sign, _ in terms)
        axes = cls(order, signs)  # type: ignore[arg-type]
        if axes.determinant < 0 and not allow_mirror:
            raise InputError(
                f"{text!r} is a mirror, not a rotation: toolface would run backwards",
                field="axes",
                remedy="check the signs, or set allow_mirror = true for a left-handed sensor",
            )
        return axes

    @property
    def determinant(self) -> int:
        """+1 for a rotation, -1 for a mirror."""
        i, j, k = self.order
        permutation = (j - i) * (k - i) * (k - j) // 2
        return round(permutation * self.signs[0] * self.signs[1] * self.signs[2])

    @property
    def identity(self) -> bool:
        return self == AxisMap()

    def apply(self, x: V, y: V, z: V) -> tuple[V, V, V]:
        """Maker's components -> tool components (the unit does not matter; None stays None)."""
        v = (x, y, z)
        (i, j, k), (si, sj, sk) = self.order, self.signs
        return _signed(v[i], si), _signed(v[j], sj), _signed(v[k], sk)


def _signed(value: V, sign: float) -> V:
    return value if value is None or sign > 0 else -value
