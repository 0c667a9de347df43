"""Pictures of a diagnosis as SVG: numbers beside axes, marks in their places, words that stay words."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from highside.report.diagnosis_figures import law_surface
from highside.report.drawing import Area, Bar, Level, Line, Panel, Picture, Points, Strip, Surface, Words
from highside.report.drawing.letters import width
from highside.report.drawing.marks import coloured, png
from highside.report.drawing.scale import MOST, Scale, limits_of

SVG = "{http://www.w3.org/2000/svg}"
finite = st.floats(-1e12, 1e12, allow_nan=False)


def value_of(words: str, factor: str) -> float:
    """The number that is written beside an axis."""
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    plain = words.replace("−", "-")
    times = re.fullmatch(r"×10(.+)", factor)
    if power := re.fullmatch(r"(?:(\d+)×)?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", plain):
        return float(f"{power[1] or 1}e{power[2].translate(raised)}")
    return float(plain + (f"e{times[1].translate(raised)}" if times else ""))


@given(st.tuples(finite, finite).filter(lambda ab: ab[1] - ab[0] > 1e-9 * (1e-6 + abs(ab[0]) + abs(ab[1]))))
@example((-1e-5, 2e-5))
@example((0.0, 1.0))
@example((471200.0, 471800.0))
def test_numbers_are_where_they_say_evenly_apart_and_not_too_many(ends: tuple[float, float]) -> None:
    low, high = ends
    scale = Scale(low, high, 0.0, 200.0)
    ticks = scale.ticks(30.0)
    assert 1 <= len(ticks.at) <= MOST + 1
    assert len(set(ticks.words)) == len(ticks.words)
    slack = 1e-6 * (high - low)
    assert all(low - slack <= value <= high + slack for value in ticks.at)
    said = [value_of(words, ticks.factor) for words in ticks.words]
    assert said == pytest.approx(list(ticks.at), abs=slack, rel=1e-9)
    assert np.ptp(np.diff(ticks.at)) <= slack if len(ticks.at) > 2 else True
    assert [float(at) for at in scale(np.array([low, high]))] == [0.0, 200.0]


@given(st.floats(-12, 12), st.floats(0.05, 20))
def test_numbers_of_a_scale_of_powers_are_where_they_say(low: float, decades: float) -> None:
    scale = Scale(10.0**low, 10.0 ** (low + decades), 100.0, 0.0, log=True)
    ticks = scale.ticks(20.0)
    assert 1 <= len(ticks.at) <= 11
    assert [value_of(words, ticks.factor) for words in ticks.words] == pytest.approx(list(ticks.at), rel=1e-3)
    assert all(-0.01 <= at <= 100.01 for at in scale(np.array(ticks.at)))


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), max_size=8), st.booleans())
def test_limits_hold_all_that_is_a_number(values: list[float], log: bool) -> None:
    low, high = limits_of([np.array(values)], log=log)
    assert np.isfinite([low, high]).all() and low < high
    shown = [v for v in values if np.isfinite(v) and (v > 0 or not log)]
    assert all(low <= v <= high for v in shown)


def drawn(*marks: object, **fields: object) -> ET.Element:
    picture = Picture(1, 1, 5.0, 2.0)
    panel = picture.panels[0][0]
    panel.add(*marks)  # type: ignore[arg-type]
    for name, value in fields.items():
        setattr(panel, name, value)
    return ET.fromstring(picture.svg())


def test_a_line_has_a_gap_where_a_value_is_no_number_and_none_is_written() -> None:
    x, y = np.arange(6.0), np.array([1.0, 2.0, np.nan, 3.0, np.inf, 4.0])
    svg = drawn(Line(x, y, "#ff0000"))
    (path,) = [p.get("d") for p in svg.iter(f"{SVG}path") if p.get("stroke") == "#ff0000"]
    assert path is not None and path.count("M") == 3 and path.count("L") == 1
    assert not re.search("nan|inf", ET.tostring(svg, encoding="unicode"))


def test_a_deviation_is_drawn_where_it_is_known() -> None:
    x, std = np.arange(4.0), np.array([1.0, np.nan, np.inf, 0.5])
    svg = drawn(Points(x, x, "#ff0000", std=std))
    dots, bars = [p.get("d") or "" for p in svg.iter(f"{SVG}path") if p.get("stroke") == "#ff0000"]
    assert dots.count("M") == 4 and bars.count("V") == 2
    assert not re.search("nan|inf", ET.tostring(svg, encoding="unicode"))


def test_what_cannot_be_drawn_says_why() -> None:
    with pytest.raises(ZeroDivisionError, match="own words"):
        drawn(Unable())


class Unable(Line):
    """A mark that fails."""

    def __init__(self) -> None:
        super().__init__(np.arange(2.0), np.arange(2.0))

    def svg(self, x: Scale, y: Scale) -> Iterator[ET.Element]:
        raise ZeroDivisionError("own words")
        yield


def test_of_a_scale_of_powers_what_is_not_positive_is_left_out() -> None:
    svg = drawn(Line(np.arange(3.0), np.array([1.0, 0.0, 100.0]), "#ff0000"), log=True)
    words = [t.text for t in svg.iter(f"{SVG}text")]
    assert {"10⁰", "10¹", "10²"} <= set(words)
    assert "nan" not in ET.tostring(svg, encoding="unicode")


def test_every_mark_lies_within_the_picture_and_keeps_its_order() -> None:
    x = np.linspace(0.0, 10.0, 11)
    svg = drawn(
        Strip(2.0, 3.0, "#111111", 0.1, upright=True), Level(0.0, "#222222"), Area(x, x - 1, x + 1, "#333333", 0.2),
        Points(x, x, "#444444", "dots", std=0 * x + 0.5), Bar(1, 0.0, 4.0, "#555555"), Words(5.0, 5.0, "here"),
        Line(x, x, "#666666", "line"), title="a", x_label="b", y_label="c", legend=True,
    )  # fmt: skip
    numbers = [float(v) for e in svg.iter() for k in ("x", "y") if (v := e.get(k)) is not None]
    wide, tall = 5.0 * 72, 2.0 * 72
    assert all(-0.1 <= v <= max(wide, tall) for v in numbers)
    for path in svg.iter(f"{SVG}path"):
        pairs = re.findall(r"([-\d.]+),([-\d.]+)", path.get("d") or "")
        assert all(-0.1 <= float(a) <= wide and -0.1 <= float(b) <= tall for a, b in pairs)
    colours = [c for e in svg.iter() for k in ("fill", "stroke") if (c := e.get(k) or "").startswith("#")]
    first = [c for c in dict.fromkeys(colours) if len(set(c[1:])) == 1]
    assert first == ["#111111", "#222222", "#333333", "#444444", "#555555", "#666666"]
    assert {"a", "b", "c", "dots", "line", "here"} <= {t.text for t in svg.iter(f"{SVG}text")}


def test_words_in_a_picture_are_words_whatever_they_are() -> None:
    bad = '<script>alert(1)</script> & "'
    svg = drawn(Words(0.0, 0.0, bad), Line(np.arange(2.0), np.arange(2.0), label=bad), title=bad, legend=True)
    assert [t.text for t in svg.iter(f"{SVG}text")].count(bad) == 3
    assert not list(svg.iter(f"{SVG}script"))


def test_rows_with_names_go_down() -> None:
    svg = drawn(Bar(0, 0.0, 2.0, "#aa0000"), Bar(1, 0.0, 1.0, "#00aa00"), y_names=["first", "second"])
    first, second = (r for r in svg.iter(f"{SVG}rect"))
    assert float(first.get("y") or 0) < float(second.get("y") or 0)
    assert float(first.get("width") or 0) == pytest.approx(2 * float(second.get("width") or 0), abs=0.2)


def test_axes_of_a_column_lie_below_one_another_and_letters_take_no_room_of_others() -> None:
    picture = Picture(2, 2)
    for k, panel in enumerate(panel for line in picture.panels for panel in line):
        panel.add(Line(np.arange(3.0), 10.0 ** (3 * k) * np.arange(3.0)))
        panel.y_label = "y"
    svg = ET.fromstring(picture.svg())
    axes = [p.get("d") or "" for p in svg.iter(f"{SVG}path") if p.get("stroke-width") == "0.8"]
    lefts = [float(re.match(r"M([\d.]+),", d)[1]) for d in axes]  # type: ignore[index]
    assert lefts[0] == lefts[2] < lefts[1] == lefts[3]
    ends = [
        float(t.get("x") or 0) - width(t.text or "", 7.5)
        for t in svg.iter(f"{SVG}text")
        if t.get("text-anchor") == "end"
    ]
    assert min(ends) > 0


def test_a_surface_is_an_image_with_its_least_value_below_on_the_left() -> None:
    values = np.arange(6.0).reshape(2, 3)
    svg = drawn(Surface(np.arange(3.0), np.arange(2.0), values, 0.0, 5.0, ("#000000", "#ffffff")))
    image = next(svg.iter(f"{SVG}image"))
    data = base64.b64decode((image.get("href") or "").split(",")[1])
    pixels = matplotlib.image.imread(io.BytesIO(data), format="png")
    assert pixels[..., 0] == pytest.approx(values[::-1] / 5, abs=0.01)


def test_an_image_is_read_by_another_program_as_it_was() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 3)).astype(np.uint8)
    read = matplotlib.image.imread(io.BytesIO(base64.b64decode(png(pixels))), format="png")
    assert np.array_equal(np.round(255 * read[..., :3]).astype(np.uint8), pixels)


def test_colours_run_from_one_end_to_the_other() -> None:
    got = coloured(np.array([[-2.0, -1.0, 0.0, 1.0, 5.0]]), -1.0, 1.0, ("#ff0000", "#ffffff", "#0000ff"))
    assert got[0].tolist() == [[255, 0, 0], [255, 0, 0], [255, 255, 255], [0, 0, 255], [0, 0, 255]]


LARGEST = float(np.finfo(float).max)
anything = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(anything, min_size=3, max_size=8), st.booleans(), anything)
@example([-LARGEST, 0.0, LARGEST], False, 1.0)
@example([5e-324, 1.0, LARGEST], True, 1.0)
@example([-1.2e308, 1.1e308, 1e308], False, 1e308)
@example([0.0, 5e-324, 1e-323], False, 0.0)
@example([2e-310, 2e-310, 2e-310], True, 0.0)
def test_whatever_the_values_every_mark_is_drawn_within_the_picture(values: list[float], log: bool, one: float) -> None:
    y, x = np.array(values), np.arange(float(len(values)))
    with np.errstate(over="ignore", invalid="ignore"):
        marks = (
            Line(x, y, dots=2.0), Line(y, x), Points(y, y), Area(x, y, y[::-1], "#333333", 0.2), Level(one, "#222222"),
            Strip(one, values[0], "#111111", 0.1), Strip(one, values[0], "#111111", 0.1, upright=True),
        )  # fmt: skip
        svg = drawn(*marks, title="a", x_label="b", y_label="c", log=log)
    written = ET.tostring(svg, encoding="unicode")
    assert not re.search(r"nan|inf", written)
    for path in svg.iter(f"{SVG}path"):
        for a, b in re.findall(r"([-\d.]+),([-\d.]+)", path.get("d") or ""):
            assert -0.1 <= float(a) <= 5 * 72 + 0.1 and -0.1 <= float(b) <= 2 * 72 + 0.1


@pytest.mark.parametrize(
    ("low", "high"),
    [(-LARGEST, LARGEST), (0.0, LARGEST), (-1.2e308, 1.1e308), (1e-320, 9e-320), (-3e-310, 1e-309), (1e250, 4e250)],
)
def test_numbers_at_the_ends_of_what_a_number_can_be_are_where_they_say(low: float, high: float) -> None:
    scale = Scale(low, high, 0.0, 200.0)
    ticks = scale.ticks(30.0)
    assert 3 <= len(ticks.at) <= MOST + 1 and np.isfinite(ticks.at).all()
    said = [value_of(words, ticks.factor) for words in ticks.words]
    assert said == pytest.approx(list(ticks.at), rel=1e-3, abs=0.0)
    at = scale(np.array([low, low / 2 + high / 2, high]))
    assert at.tolist() == pytest.approx([0.0, 100.0, 200.0], abs=0.2)


def test_a_surface_that_is_nothing_anywhere_has_the_colour_of_nothing() -> None:
    x = np.linspace(0.0, 1.0, 4)
    law = LawOfNothing(std=0.25)
    svg = ET.fromstring(law_surface(law).svg())  # type: ignore[arg-type]
    of_law = images(svg)[0][0]
    assert len(list(svg.iter(f"{SVG}image"))) == 4  # each beside its colours
    assert np.ptp(of_law, axis=(0, 1)).max() == 0 and of_law[0, 0] == pytest.approx([0.957] * 3, abs=0.01)
    numbers = {t.text for t in svg.iter(f"{SVG}text")}
    assert "200" in numbers and not re.search("nan|inf", ET.tostring(svg, encoding="unicode"))
    # nothing known at all: the same, and what is no number is grey
    svg = ET.fromstring(law_surface(LawOfNothing(std=0.0)).svg())  # type: ignore[arg-type]
    assert [np.ptp(rgb, axis=(0, 1)).max() for rgb, (wide, _) in images(svg) if wide > 20] == [0, 0]
    values = np.array([[np.nan, 0.0], [np.inf, -np.inf]])
    assert coloured(values, -1.0, 1.0, ("#000000", "#ffffff")).tolist() == [
        [[128, 136, 144], [128, 128, 128]],
        [[255] * 3, [0] * 3],
    ]
    # a range that is longer than the largest number
    svg = drawn(Surface(x, x, np.full((4, 4), LARGEST), -LARGEST, LARGEST, ("#000000", "#ffffff")))
    assert images(svg)[0][0].min() == 1.0 and "nan" not in ET.tostring(svg, encoding="unicode")


class LawOfNothing:
    """A law of two covariates whose value is zero wherever it is known."""

    axes = (SimpleNamespace(low=0.0, high=1.0), SimpleNamespace(low=0.0, high=1.0))
    at = SimpleNamespace(unit="g")
    depends_on = ("temp_c", "t_s")

    def __init__(self, std: float) -> None:
        self._std = std

    def value(self, at: list[np.ndarray]) -> np.ndarray:
        return np.zeros(at[0].size)

    def std(self, at: list[np.ndarray]) -> np.ndarray:
        return np.full(at[0].size, self._std)


def images(svg: ET.Element) -> list[tuple[np.ndarray, tuple[float, float]]]:
    """Red, green and blue (0 to 1) of each image of a picture, and its width and height, pt."""
    found = []
    for image in svg.iter(f"{SVG}image"):
        data = base64.b64decode((image.get("href") or "").split(",")[1])
        read = matplotlib.image.imread(io.BytesIO(data), format="png")[..., :3]
        found.append((read, (float(image.get("width") or 0), float(image.get("height") or 0))))
    return found


def test_long_names_are_cut_short_and_leave_the_axes_their_room() -> None:
    long = [f"{k} " + "reference_voltage_" * 9 for k in range(3)]
    assert all(len(name) >= 164 for name in long)
    x = np.arange(3.0)
    bars = drawn(*(Bar(k, 0.0, k + 1.0, "#aa0000") for k in range(3)), y_names=long)
    assert min(float(r.get("width") or 0) for r in bars.iter(f"{SVG}rect")) > 30.0
    lines = drawn(
        Line(x, x, "#aa0000", long[0]), Line(x, x, "#00aa00", "short"), Points(x, x, "#0000aa", long[1]),
        x_names=long, title=long[0], x_label=long[1], y_label=long[2], legend=True,
    )  # fmt: skip
    for svg in (bars, lines):
        for words in svg.iter(f"{SVG}text"):
            start, end = span(words)
            assert start >= -1.0 and end <= 5 * 72 + 1.0, words.text
        # whole where the pointer rests on it
        assert {t.text for t in svg.iter(f"{SVG}title")} >= set(long) - {""}
    (axes,) = [p.get("d") or "" for p in lines.iter(f"{SVG}path") if p.get("stroke-width") == "0.8"]
    left, top, foot, right = map(float, re.match(r"M([\d.]+),([\d.]+)V([\d.]+)H([\d.]+)", axes).groups())  # type: ignore[union-attr]
    assert right - left > 150.0 and foot - top > 20.0
    assert "short" in {t.text for t in lines.iter(f"{SVG}text")}


def test_a_name_that_is_too_long_for_a_line_has_two_and_is_whole_where_the_pointer_rests() -> None:
    names = ["short", "an error of the reference toolface that follows rate and load", "a " + "very " * 60 + "long one"]
    svg = drawn(*(Bar(k, 0.0, k + 1.0, "#aa0000") for k in range(3)), y_names=names)
    lines = [t.text or "" for t in svg.iter(f"{SVG}text") if t.get("text-anchor") == "end"]
    assert lines[0] == "short"
    assert " ".join(lines[1:3]) == names[1]
    assert " ".join(lines[3:]).startswith("a very very") and lines[-1].endswith("\N{HORIZONTAL ELLIPSIS}")
    assert {t.text for t in svg.iter(f"{SVG}title")} == {names[2]}


def span(words: ET.Element) -> tuple[float, float]:
    """From where to where words reach, pt: along x, of those that stand upright in height."""
    size, own = float(words.get("font-size") or 0), width(words.text or "", float(words.get("font-size") or 0))
    turned = re.match(r"rotate\((-?\d+)", words.get("transform") or "rotate(0")
    along = np.cos(np.radians(float(turned[1]))) if turned else 1.0
    share = {"start": 0.0, "middle": 0.5, "end": 1.0}[words.get("text-anchor") or "start"]
    x = float(words.get("x") or 0)
    return x - share * own * along - (size if along == 0 else 0), x + (1 - share) * own * along


def test_an_empty_panel_is_drawn() -> None:
    assert ET.fromstring(Picture(1, 2).svg()).tag == f"{SVG}svg"
    assert Panel().labelled() == []


def test_the_page_of_a_diagnosis_is_drawn_without_matplotlib() -> None:
    program = "import sys, highside.report.diagnosis_page; assert 'matplotlib' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0
