"""Which cases a set has: kinds, effects, signal-to-noise ratios, excitations; all from a seed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.blind.effect_shapes import SHAPES
from tests.blind.excitations import KINDS
from tests.blind.random_effects import (
    DECOYS,
    DISCRETE,
    LINES,
    OUT_OF_CATALOGUE,
    STAND_DECOYS,
    STOCHASTIC,
)
from tests.real_recordings import place

LADDER = (3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0, 40.0)
SINGLES = (*SHAPES, "gyro.dead_band", "gyro.saturation", *STOCHASTIC, *LINES)
_SCALABLE = tuple(name for name in SHAPES if name != "stand.earth_rate")
"""Earth turns at its own rate."""
_WITHHELD = tuple(name for name in _SCALABLE if name != "stand.encoder_eccentricity")
"""What is called ripple of the rate once per turn says the same as an eccentric encoder."""
LEFT_OUT = {
    "gnss.latency, clock_step, antenna_lever_arm, multipath": "no GNSS channel in these recordings",
    "mag.hard_iron, soft_iron": "constants: recalibrated as bias and matrix at every mount",
    "mag.current_coupling": "no current channel",
    "acc.vibration_rectification": "needs a vibration far above these output rates",
    "stand.remount_misalignment, rate_scale_factor": "constants of a mount: recalibrated as its matrix",
    "stand.motor_field, chamber_gradient, chamber_lag": "the contract does not say what they do to a channel",
    "stand.crank_geometry": "no crank stand among the excitations",
}

_ROTATING = ("staircase", "tumble", "swing")
_HEATED = ("staircase", "static_ramp")
SHOWN_BY: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(
        ("gyro.scale_factor_temperature", "gyro.misalignment_temperature", "acc.scale_factor_temperature",
         "mag.scale_factor_temperature"),
        ("staircase",),
    ),
    **dict.fromkeys(
        ("gyro.bias_temperature", "gyro.thermal_hysteresis", "gyro.temperature_rate", "acc.bias_temperature",
         "acc.thermal_hysteresis"),
        _HEATED,
    ),
    **dict.fromkeys(
        ("gyro.warm_up", "acc.warm_up"), _HEATED
    ),
    **dict.fromkeys(("gyro.bias_instability", "gyro.rate_random_walk", "acc.bias_instability",
                     "gyro.angle_random_walk", "acc.velocity_random_walk", "gyro.supply_sensitivity",
                     "link.aliasing", *DISCRETE), KINDS),
    **dict.fromkeys(("stand.wobble", "stand.rate_ripple", "stand.encoder_eccentricity"),
                    ("staircase", "tumble")),
    "acc.shock_bias_shift": ("swing",),
    **dict.fromkeys(("link.timestamp_jitter", "link.counter_wrap"), _ROTATING),
    **dict.fromkeys(("mag.white_noise", "mag.mains_interference", "gyro.magnetic_sensitivity"),
                    ("tumble", "swing")),
    "stand.level_drift": KINDS,
    "bump_in_time": KINDS, "telegraph_bias": KINDS,
    "second_order_drift": _HEATED,
    **dict.fromkeys(("harmonic_mix", "rate_times_force"), ("tumble", "swing")),
    "mag_follows_supply": KINDS,
    **dict.fromkeys(("acc_follows_temperature_rate",), _HEATED),
    **dict.fromkeys(("mag_follows_temperature_rate",), ("staircase",)),
}  # fmt: skip
"""Excitations to try for an effect; all that turn, where it is not named. Which of them shows it, and
how strongly, is decided by the signal-to-noise ratio itself."""


@dataclass(frozen=True)
class CaseSpec:
    """What is wanted of a case; the generator may have to take another effect (the label says which).

    Attributes:
        number: its place in the set.
        kind: null, single, discrete, pair, out_of_catalogue, decoy, decoy_stand, withheld, semi_real.
        effects: wanted names.
        d: wanted signal-to-noise ratio, 0 for none.
        excitation: kind of test.
        instance: which of the set's instances of that kind.
    """

    number: int
    kind: str
    effects: tuple[str, ...]
    d: float
    excitation: str
    instance: int


def real_noise_folder() -> Path | None:
    """The real static record that semi-real cases take their noise from; None if it is not there."""
    folder = place() / "mpu6050_multipos_tomisuarez" / "static-449s"
    return folder if (folder / "dut.npz").exists() else None


def shares(size: str, cases: int | None) -> dict[str, int]:
    """How many cases of each kind."""
    weights = {"null": 25, "single": 40, "discrete": 5, "pair": 9, "out_of_catalogue": 8, "decoy": 3,
               "decoy_stand": 3, "withheld": 4, "semi_real": 3}  # fmt: skip
    if size == "nightly" and cases is None:
        return {
            **{"null": 1000, "single": 300 * len(LADDER), "discrete": 120, "pair": 300},
            **{"out_of_catalogue": 300, "decoy": 100, "decoy_stand": 100, "withheld": 150, "semi_real": 60},
        }
    total = cases or {"quick": 40, "default": 400}[size]
    counts = {kind: max(1, round(total * weight / 100)) for kind, weight in weights.items()}
    counts["single"] += total - sum(counts.values())
    return counts


def plan(size: str, seed: int, cases: int | None = None) -> list[CaseSpec]:
    """The set's cases in a random order, so that a number says nothing about a label."""
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 1))))
    counts = shares(size, cases)
    if real_noise_folder() is None:
        counts["null"] += counts.pop("semi_real")
    instances = max(1, round(sum(counts.values()) / 60))
    wanted: list[tuple[str, tuple[str, ...], float]] = []
    for kind, count in counts.items():
        wanted += _wanted(rng, kind, max(count, 0))
    order = rng.permutation(len(wanted))
    return [
        CaseSpec(number, kind, effects, d, _excitation(rng, effects), int(rng.integers(instances)))
        for number, (kind, effects, d) in enumerate((wanted[i] for i in order), 1)
    ]


def _excitation(rng: np.random.Generator, effects: Sequence[str]) -> str:
    possible = set(KINDS)
    for name in effects:
        shown = set(SHOWN_BY.get(name, _ROTATING))
        possible = possible & shown or shown
    return str(rng.choice(sorted(possible)))


def _cycled(rng: np.random.Generator, names: Sequence[str], count: int) -> list[str]:
    """Each name equally often, in a random order."""
    rounds = [rng.permutation(len(names)) for _ in range(count // len(names) + 1)]
    return [names[i] for one in rounds for i in one][:count]


def _wanted(rng: np.random.Generator, kind: str, count: int) -> list[tuple[str, tuple[str, ...], float]]:
    if kind == "null":
        return [("null", (), 0.0)] * count
    high = (8.0, 12.0, 20.0, 40.0)
    names, ladder = {
        "single": (SINGLES, LADDER),
        "discrete": (DISCRETE, (0.0,)),
        "pair": (_SCALABLE, (6.0, 8.0, 12.0, 20.0)),
        "out_of_catalogue": (tuple(OUT_OF_CATALOGUE), high),
        "decoy": (tuple(DECOYS), (12.0, 20.0)),
        "decoy_stand": (STAND_DECOYS, high),
        "withheld": (_WITHHELD, (12.0, 20.0, 40.0)),
        "semi_real": (("", "gyro.scale_factor_asymmetry", "gyro.g_sensitivity", "link.fixed_delay",
                       "gyro.even_nonlinearity", "acc.quadratic_nonlinearity"), (8.0, 12.0, 20.0)),
    }[kind]  # fmt: skip
    chosen = _cycled(rng, names, count)
    wanted = []
    for i, name in enumerate(chosen):
        effects = (name,) if name else ()
        if kind == "pair":
            partners = [x for x in names if x != name and set(_shown(x)) & set(_shown(name))]
            effects = (name, str(rng.choice(partners)))
        wanted.append((kind, effects, ladder[i % len(ladder)] if effects else 0.0))
    return wanted


def _shown(name: str) -> tuple[str, ...]:
    return SHOWN_BY.get(name, _ROTATING)
