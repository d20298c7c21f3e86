"""The hidden part of a case: which signal, at which amplitude, so that it has the wanted d."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.catalogue import Catalogue, applies, largest_rate, projection
from tests.blind.effect_shapes import SHAPES, THRESHOLDS, Block
from tests.blind.excitations import Excitation
from tests.blind.metric import Metric
from tests.blind.random_effects import DECOYS, LINES, OUT_OF_CATALOGUE, line_signal

Array = NDArray[np.float64]

MAX_PARALLEL_RATIO = 8.0
"""Of the whole length of an uncatalogued signal to its part outside every catalogue effect: beyond it,
the signal is a catalogue effect for all practical purposes."""


@dataclass
class Hidden:
    """A signal channel to (rows,), its d, and what the label says of it."""

    signal: dict[str, Array]
    d: float
    facts: dict[str, Any] = field(default_factory=dict)


def single(
    rng: np.random.Generator, excitation: Excitation, metric: Metric, name: str, d: float
) -> Hidden | None:
    """A catalogue effect at signal-to-noise ratio d; None where this excitation cannot show it."""
    if not applies(excitation, name):
        return None
    if name in LINES:
        signal, frequency = line_signal(rng, excitation, name)
        return _scaled(metric, name, signal, d, np.inf, {"phi": frequency})
    if name in THRESHOLDS:
        return _threshold(rng, excitation, metric, name, d)
    shape = SHAPES[name]
    phi = shape.drawn_phi(rng)
    blocks = shape.blocks(excitation, phi)
    if not shape.whole and len(blocks) > 1 and rng.random() < 0.6:
        blocks = [blocks[int(rng.integers(len(blocks)))]]
    weights = [rng.normal(size=next(iter(block.values())).shape[1]) for block in blocks]
    if shape.positive:
        weights = [np.abs(one) for one in weights]
    if name == "stand.earth_rate":
        weights = [np.ones(1)]
    signal = {c: x @ w for block, w in zip(blocks, weights, strict=True) for c, x in block.items()}
    norm = float(np.linalg.norm(np.concatenate(weights)))
    facts = {"phi": phi, "coefficients": [{"channels": sorted(b), "values": w.tolist()}
                                          for b, w in zip(blocks, weights, strict=True)]}  # fmt: skip
    hidden = _scaled(metric, name, signal, d, shape.limit / norm, facts)
    if hidden is not None:
        for one in hidden.facts["coefficients"]:
            one["values"] = [value * hidden.facts["scale"] for value in one["values"]]
    return hidden


def _scaled(
    metric: Metric, name: str, signal: dict[str, Array], d: float, limit: float, facts: dict[str, Any]
) -> Hidden | None:
    """The signal scaled to d; None if that takes more than the limit, or recalibration takes it away."""
    signal = {c: x for c, x in signal.items() if c in metric.channels}
    own = metric.signal_to_noise(signal)
    raw = np.sqrt(sum(float(np.sum(metric.channels[c].whitened(x[:, None]) ** 2)) for c, x in signal.items()))
    if own < 1e-3 * raw or own == 0 or d / own > limit:
        return None
    scale = d / own
    facts = {"effect": name, "scale": scale, **facts}
    return Hidden({c: x * scale for c, x in signal.items()}, d, facts)


def _threshold(
    rng: np.random.Generator, excitation: Excitation, metric: Metric, name: str, d: float
) -> Hidden | None:
    """By bisection: a larger dead band, or a lower saturation, has a larger d."""
    of_threshold, _ = THRESHOLDS[name]
    top = largest_rate(excitation)
    axes = [int(rng.integers(3))] if rng.random() < 0.6 else [0, 1, 2]
    low, high = (1e-3, 0.1 * top + 1e-3) if name == "gyro.dead_band" else (0.3 * top, top)
    rising = name == "gyro.dead_band"

    def at(threshold: float) -> dict[str, Array]:
        blocks = of_threshold(excitation, threshold)
        return {c: x[:, 0] for axis in axes for c, x in blocks[axis].items()}

    if metric.signal_to_noise(at(high if rising else low)) < d:
        return None
    for _ in range(22):
        middle = float(np.sqrt(low * high))
        if (metric.signal_to_noise(at(middle)) < d) == rising:
            low = middle
        else:
            high = middle
    signal = at(high)
    reached = metric.signal_to_noise(signal)
    if abs(reached / d - 1) > 0.1:
        return None
    return Hidden(signal, reached, {"effect": name, "phi": high, "channels": sorted(signal)})


def foreign(
    rng: np.random.Generator,
    excitation: Excitation,
    metric: Metric,
    catalogue: Catalogue,
    name: str,
    d: float,
) -> Hidden | None:
    """A signal outside the catalogue whose part outside every single catalogue effect has the length d."""
    signal = {**OUT_OF_CATALOGUE, **DECOYS}[name](rng, excitation)
    signal = {c: x for c, x in signal.items() if c in metric.channels}
    return scaled_outside(metric, catalogue, name, signal, d, without=()) if signal else None


def scaled_outside(
    metric: Metric, catalogue: Catalogue, name: str, signal: Block, d: float, without: tuple[str, ...]
) -> Hidden | None:
    """`signal` scaled so that d is its distance from all catalogue effects but those `without`."""
    whole = metric.signal_to_noise(signal)
    if whole == 0:
        return None
    unit = {c: x[:, None] / whole for c, x in signal.items()}
    among, across, own = catalogue.gram(metric, unit)
    explained = [
        (projection(among, across[:, 0], option)[1], option.effect)
        for option in catalogue.options
        if option.effect not in without
    ]
    nearest = max(explained, default=(0.0, ""))
    outside = np.sqrt(max(own[0, 0] - nearest[0], 0))
    if outside < 1 / MAX_PARALLEL_RATIO:
        return None
    scale = d / outside / whole
    facts = {"effect": name, "scale": scale, "d_outside": d, "nearest": nearest[1]}
    return Hidden({c: x * scale for c, x in signal.items()}, d / outside, facts)
