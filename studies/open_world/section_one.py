"""The failures that were found by trying, each made again from its description: `table/ROW/k`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from studies.sealed import deck as library_deck
from studies.sealed import world as library_world

from . import beside_simulation, by_hand, deck, designs, noises, world
from .answers import Case, model_of
from .laws import Law
from .noises import Noise
from .shapes import Shape
from .world import Session

ROWS = 60e-6 * np.sqrt(library_world.ROWS_A_POSE), 80e-6
"""noise of a row of the other deck's two designs, g"""


def stepped(rng: np.random.Generator) -> Session:
    """The other deck's own stepped session: eleven stations of twelve toolfaces, and returns from the other side."""
    p = library_world.pose_programme(rng)
    zero = np.zeros(p.n)
    return Session("poses", p.t, p.inc, p.tf, p.temp, p.pose, p.side, zero, zero, zero, returns=True)


def turning(rng: np.random.Generator, *, gyros: bool = False) -> Session:
    """The other deck's own rotation: ten rates in four minutes, 50 Hz."""
    p = library_world.rotation_programme(rng, gyros=gyros)
    fine = np.arange(p.rate_fine.size) / library_world.FINE_HZ
    rate = np.interp(p.t, fine, p.rate_fine)
    acceleration = np.interp(p.t, fine, np.gradient(p.rate_fine, 1 / library_world.FINE_HZ))
    return Session(
        "rotation",
        p.t,
        p.inc,
        p.tf,
        p.temp,
        np.zeros(0, dtype=int),
        p.side,
        rate,
        acceleration,
        p.vibration,
        gyros=gyros,
    )


def white(s: Session) -> Noise:
    row = ROWS[0] if s.kind == "poses" else ROWS[1]
    return Noise("white", tuple([row] * 3 + ([noises.GYRO_SIGMA] * 3 if s.gyros else [])))


def _law(place: str, covariates: tuple[str, ...], shape: Shape, s: Session, **more: object) -> Law:
    from . import laws

    ranges = tuple(
        # a power of the load is one of the load itself
        (-1.0, 1.0) if n.startswith("load") else (float(laws.covariate(s, n).min()), float(laws.covariate(s, n).max()))
        for n in covariates
    )
    return Law(place, covariates, shape, ranges, 1e-3, **more)  # type: ignore[arg-type]


def _process(rng: np.random.Generator) -> Shape:
    from . import shapes

    return shapes.process(rng, (rng.uniform(0.6, 1.5),))


def _odd(exponent: float, *, odd: bool) -> Shape:
    return Shape("power", {"at": 0.0, "exponent": exponent, "odd": odd})


def outsiders(rng: np.random.Generator, s: Session) -> dict[str, tuple[Law, tuple[str, ...]]]:
    """The smooth outsiders by their name: the law, and names of a library that holds it by now."""
    axis = int(rng.integers(3 if s.kind == "poses" else 2))
    own = tuple(np.eye(3)[axis])
    load = f"load_{'xyz'[axis]}"
    element = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)][int(rng.integers(6))]
    centre = {"phase": rng.uniform(0, 6), "frequency": rng.uniform(1.2, 1.8), "at": 0.0}
    found = {
        "bench leaning with time": (_law("level", ("time",), _process(rng), s, weights=(1.0, 0.0, 0.0)), ("*lean*",)),
        "eccentric inclination encoder": (
            _law("inclination", ("inc",), Shape("sine", centre), s), ("inclination_encoder*", "inclination*harmonic*"),
        ),
        "load times its modulus": (
            _law("offset", (load,), _odd(2.0, odd=True), s, weights=own),
            ("odd_quadratic", "quadratic_odd*", "*modulus*"),
        ),
        "fourth power": (_law("offset", (load,), _odd(4.0, odd=False), s, weights=own), ()),
        "scale drift": (
            _law("scale", ("time",), _process(rng), s, weights=(1.0, 1.0, 1.0)),
            ("reference_voltage*", "*scale_drift*"),
        ),
        "temperature times misalignment": (
            _law("matrix", ("temp",), Shape("identity", {}), s, element=element),
            ("temperature_misalignment*", "*misalignment*"),
        ),
    }  # fmt: skip
    if s.kind == "rotation":
        del found["bench leaning with time"], found["eccentric inclination encoder"]
    return found


def outsider(name: str, seed: str, design: str, which: str) -> Case:
    """A smooth outsider in the deck's own design, in white noise, strength 400 to 9,000; with a second session."""
    rng = deck.rng_of(seed, name)
    s = stepped(rng) if design == "poses" else turning(rng)
    law, right = outsiders(rng, s)[which]
    noise, sensor = white(s), world.drawn_sensor(rng)
    law = deck.sized(s, sensor, law, noise, float(np.exp(rng.uniform(np.log(400), np.log(9000)))))
    second = designs.second(rng, s)
    case = deck.built(name, "table", rng, s, noise, (law,), sensor, second, plain=True)
    case.right, case.note = right, f"{which}, {'stepped' if design == 'poses' else 'rotation'}"
    return case


def effects(
    name: str, seed: str, s_of: Callable[[np.random.Generator], Session], names: tuple[str, ...], strength: float,
    note: str, *, noise_kind: str = "white", lost: float = 0.0, right: tuple[str, ...] = (),
) -> Case:  # fmt: skip
    """Effects of the library, each of a strength, in a design."""
    rng = deck.rng_of(seed, name)
    s = s_of(rng)
    programme, s = deck.as_programme(s)
    noise = white(s)
    if noise_kind != "white":
        slow = 0.6 if noise_kind == "coloured" else 2.0 / np.sqrt(np.ptp(s.t))
        noise = Noise(noise_kind, noise.sigma, tau=0.02 * float(np.ptp(s.t)), level=slow)
    sensor = library_world.some_sensor(rng)
    drawn = library_deck.POSE_EFFECTS if s.kind == "poses" else library_deck.ROTATION_EFFECTS
    truth: dict[str, dict[str, float]] = {}
    for effect in names:
        for _ in range(20):
            values = deck._effect_sized(
                programme, s, sensor, effect, deck._within_session(drawn[effect](rng), effect, s), noise, strength
            )
            if values is not None:
                truth[effect] = values
                break
    base = library_deck._earth(programme)
    clean = library_deck._stacked(*library_world.readings(programme, sensor, {**base, **truth}))
    plain = library_deck._stacked(*library_world.readings(programme, sensor, base))
    data = noises.added(rng, s, noise, clean)
    kept = designs.missing(rng, s, lost) if lost else np.ones(s.n, dtype=bool)
    recorded = world.columns(s.rows(kept), data[:, kept])
    case = Case(name, "table", s.kind, recorded, model_of(s), noise_kind, first=s.rows(kept))
    case.effects, case.sigma, case.note, case.right = truth, noise.sigma, note, right
    added = world.off_base(s, clean - plain)
    case.strength = noises.energy(s, noise, added)
    case.hidden = (added / np.array(noise.sigma)[:, None])[:, kept]
    return case


def gyro_law(name: str, seed: str, kind: str) -> Case:
    """A gyro's offset that follows the temperature, a warm-up or a step."""
    rng = deck.rng_of(seed, name)
    s = turning(rng, gyros=True)
    weights = tuple(np.eye(3)[int(rng.integers(3))])
    law, right = {
        "temperature": (
            _law("gyro_offset", ("temp",), Shape("identity", {}), s, weights=weights),
            ("gyro_temperature*", "gyro_thermal*"),
        ),
        "warm-up": (
            _law("gyro_offset", ("time",), Shape("exponential", {"width": -0.25}), s, weights=weights),
            ("gyro_warmup*",),
        ),
        "step": (
            _law("gyro_offset", ("time",), Shape("threshold_tanh", {"at": 0.1, "width": 1e-3}), s, weights=weights),
            ("gyro_step*", "gyro_bias_step*"),
        ),
    }[kind]  # fmt: skip
    noise, sensor = white(s), world.drawn_sensor(rng)
    law = deck.sized(s, sensor, law, noise, 2000.0)
    case = deck.built(name, "table", rng, s, noise, (law,), sensor, None, plain=True)
    case.right, case.note = right, f"gyro offset: {kind}"
    return case


def twelve_bits(name: str, seed: str) -> Case:
    """A rotation read by a converter of twelve bits for 4 g, nothing left out."""
    rng = deck.rng_of(seed, name)
    s = turning(rng)
    noise = Noise("quantised", (2e-4,) * 3, step=4.0 / 4096)
    case = deck.built(name, "table", rng, s, noise, (), world.drawn_sensor(rng), None, plain=True)
    case.right, case.note = ("verdict:nothing_left_out",), "12-bit readings in rotation, nothing left out"
    return case


def few_poses(name: str, seed: str) -> Case:
    """Sixteen poses, a quadratic and a step."""

    def small(rng: np.random.Generator) -> Session:
        p = library_world.pose_programme(rng, (10.0, 40.0, 70.0, 100.0), 4, both_sides=False)
        zero = np.zeros(p.n)
        return Session("poses", p.t, p.inc, p.tf, p.temp, p.pose, p.side, zero, zero, zero)

    return effects(name, seed, small, ("quadratic", "bias_step"), 200.0, "16 poses, quadratic and step of strength 200",
                   right=("verdict:unknown", "verdict:partial", "verdict:not_testable"))  # fmt: skip


def few_holds(name: str, seed: str) -> Case:
    """A session by hand of which most holds tremble."""
    rng = deck.rng_of(seed, name)
    s = by_hand.held(rng, holds=31)
    accel = by_hand.sensed(rng, s, np.zeros_like(s.up))
    trembling = np.isin(s.hold, rng.choice(31, 19, replace=False))
    accel = accel + np.where(trembling, 0.02, 0.0) * rng.standard_normal(accel.shape)
    case = Case(name, "table", "hand", by_hand.columns(s, accel), by_hand.MODEL.replace(', "misalignment"', ""))
    case.right, case.note = ("verdict:not_testable", "verdict:unknown"), "12 of 31 holds still, misalignment not free"
    return case


def cases(seed: str, each: int = 4) -> deck.Makers:
    """Every row of the table, some of each."""
    found: deck.Makers = {}

    def put(row: str, k: int, make: Callable[..., Case], *what: object, **more: object) -> None:
        name = f"table/{row}/{k}"
        found[name] = partial(make, name, seed, *what, **more)

    slow, fast = ("temperature_bias", "warmup", "bias_drift"), ("quadratic", "cubic", "sag", "encoder_first_harmonic")
    some = np.random.default_rng(0)
    for k in range(each):
        for design, s in (("poses", stepped(some)), ("rotation", turning(some))):
            for which in outsiders(some, s):
                put(f"{which}, {design}", k, outsider, design, which)
        for noise_kind in ("coloured", "walk"):
            put(f"slow effect in {noise_kind} noise", k, effects, stepped, (slow[k % 3],), 400.0,
                f"slow effect of the library, {noise_kind}", noise_kind=noise_kind)  # fmt: skip
            put(f"fast effect in {noise_kind} noise", k, effects, stepped, (fast[k % 4],), 400.0,
                f"fast effect of the library, {noise_kind}", noise_kind=noise_kind)  # fmt: skip
        for kind in ("temperature", "warm-up", "step"):
            put(f"gyro {kind}", k, gyro_law, kind)
        put("12 bits", k, twelve_bits)
        put("16 poses", k, few_poses)
        put("rows missing", k, effects, stepped, ("quadratic",), 1000.0, "10 to 30 % of the rows missing",
            lost=(0.1, 0.2, 0.3)[k % 3])  # fmt: skip
        three = (("lever_arm", "quadratic", "temperature_bias"), ("encoder_first_harmonic", "time_offset", "backlash"))
        put("three in rotation", k, effects, turning, three[k % 2], 1000.0, "three effects in a rotation")
        five = ("quadratic", "sag", "backlash", "temperature_bias", "encoder_second_harmonic")
        put("five effects", k, effects, stepped, five, 1000.0, "five effects of strength 1,000")
        put("few holds", k, few_holds)
    for ms in (10, 20, 30, 50, 200, 2000):
        found[f"table/early/{ms}"] = partial(_early, f"table/early/{ms}", seed, ms)
    for k, share in enumerate((0.02, 0.05)):
        found[f"table/frequency/{k}"] = partial(_frequency, f"table/frequency/{k}", seed, share)
    found["table/motion missing/0"] = partial(_motion, "table/motion missing/0", seed)
    for mg in (0.3, 1.0, 3.0, 10.0, 20.0, 50.0):
        found[f"table/rest step/{mg:g}"] = partial(_rest, f"table/rest step/{mg:g}", seed, "step", mg)
    for seconds in (600, 700, 1500):
        name = f"table/rest temperature/{seconds}"
        found[name] = partial(_rest, name, seed, "temperature", 3.0, seconds=float(seconds))
    for mg in (0.5, 1.0, 2.0, 5.0, 20.0, 50.0):
        for kind in ("step", "warm-up"):
            name = f"table/hand {kind}/{mg:g}"
            found[name] = partial(_hand, name, seed, kind, mg)
    return found


def _table(case: Case) -> Case:
    case.group = "table"
    return case


def _early(name: str, seed: str, ms: float) -> Case:
    return _table(beside_simulation.early(name, deck.rng_of(seed, name), 1e-3 * ms))


def _frequency(name: str, seed: str, share: float) -> Case:
    return _table(beside_simulation.frequency_off(name, deck.rng_of(seed, name), share))


def _motion(name: str, seed: str) -> Case:
    return _table(beside_simulation.motion_missing(name, deck.rng_of(seed, name)))


def _rest(name: str, seed: str, kind: str, mg: float, **more: float) -> Case:
    return _table(by_hand.rest_case(name, deck.rng_of(seed, name), kind, 1e-3 * mg, **more))


def _hand(name: str, seed: str, kind: str, mg: float) -> Case:
    return _table(by_hand.hand_case(name, deck.rng_of(seed, name), kind, 1e-3 * mg))
