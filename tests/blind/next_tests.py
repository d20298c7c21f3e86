"""Which of the four excitations would have told the true effect from its confusable rivals: hindsight.

Information of a test, all members of the class equally probable before it:
-ln mean_j exp(-delta_j^2 / 8), delta_j the whitened distance of the true signal from rival j's best fit.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tests.blind.catalogue import Catalogue, applies, projection
from tests.blind.effect_shapes import SHAPES
from tests.blind.excitations import KINDS, Excitation, excitation
from tests.blind.hidden_signals import Hidden
from tests.blind.metric import Metric
from tests.blind.noise import ChannelNoise

Array = NDArray[np.float64]

STRETCH = 0.4
WORDS = {
    "tumble": ("tumble", "position", "pose"),
    "staircase": ("stair", "rate_and_temperature"),
    "swing": ("swing", "sweep", "sine", "oscillat", "vibration"),
    "static_ramp": ("static", "soak", "ramp", "thermal", "temperature", "cold_start", "warm"),
}
"""What a profile's name may hold, in the order of asking."""


def kind_of(profile: str) -> str | None:
    """The excitation that a proposed profile is most like, by its name; None if it is like none."""
    for kind, words in WORDS.items():
        if any(word in profile.lower() for word in words):
            return kind
    return None


@lru_cache(maxsize=8)
def _test(kind: str, magnetometer: bool) -> Excitation:
    test = excitation(kind, (6, 6), stretch=STRETCH)
    return replace(test, magnetometer=magnetometer, supply=True)


def information_rates(
    hidden: Hidden, rivals: tuple[str, ...], noise: dict[str, ChannelNoise]
) -> dict[str, float]:
    """Nats a minute for each excitation; empty where the effect has no coefficients to carry over."""
    name, coefficients = hidden.facts["effect"], hidden.facts.get("coefficients")
    if coefficients is None or len(rivals) < 2 or not all(rival in SHAPES for rival in rivals):
        return {}
    rates = {}
    for kind in KINDS:
        test = _test(kind, any(channel.startswith("mag") for channel in noise))
        minutes = sum(run.rows / run.rate_hz for run in test.runs) / 60
        rates[kind] = _information(hidden, name, rivals, noise, test) / minutes
    return rates


def _information(
    hidden: Hidden, name: str, rivals: tuple[str, ...], noise: dict[str, ChannelNoise], test: Excitation
) -> float:
    if not applies(test, name):
        return 0.0
    rate = test.runs[0].rate_hz
    metric = Metric(test, {
        channel: replace(one, rate_hz=rate, white=one.white * np.sqrt(rate / one.rate_hz))
        for channel, one in noise.items()
    })  # fmt: skip
    signal: dict[str, Array] = {}
    blocks = SHAPES[name].blocks(test, hidden.facts["phi"])
    for one in hidden.facts["coefficients"]:
        for block in blocks:
            if sorted(block) == one["channels"]:
                signal |= {c: (x @ one["values"])[:, None] for c, x in block.items() if c in noise}
    catalogue = Catalogue(test, only=rivals)
    gram, across, own = catalogue.gram(metric, signal)
    terms = [1.0]
    for rival in rivals:
        if rival != name:
            mine = [option for option in catalogue.options if option.effect == rival]
            fitted = max((projection(gram, across[:, 0], option)[1] for option in mine), default=0.0)
            terms.append(float(np.exp(-max(own[0, 0] - fitted, 0) / 8)))
    return float(-np.log(np.mean(terms)))
