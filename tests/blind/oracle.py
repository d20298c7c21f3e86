"""What the best possible reader of a case would say: it knows the noise and the generator's own shapes.

For a linear effect of k columns that explain R of the whitened, projected residual, a g-prior over the
ladder of d gives ln B = ln mean_d[(1+g)^(-k/2) exp(g/(1+g) R/2)], g = d^2/k; phi, axes and d are averaged
over with the weights the generator draws them with. Noise effects are compared by Whittle's likelihood of
the whitened residual's cosine transform, the unit-to-unit spread of the levels allowed for.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, rfft
from scipy.special import logsumexp

from tests.blind.case_plan import LADDER
from tests.blind.catalogue import Catalogue, Option
from tests.blind.effect_shapes import SHAPES, TRIADS
from tests.blind.excitations import Excitation
from tests.blind.hidden_signals import Hidden
from tests.blind.metric import Metric
from tests.blind.next_tests import information_rates
from tests.blind.noise import ChannelNoise
from tests.blind.random_effects import LINES, MAX_FACTOR, STOCHASTIC

if TYPE_CHECKING:
    from tests.blind.generate import Case

Array = NDArray[np.float64]

CONFUSABLE_LN_B = 3.0
LN_PRIOR_OF_A_SECOND = float(np.log(0.2))
"""Of a second effect, whichever: about as many pairs as that there are in a set, for each single effect."""
_D2 = np.array(LADDER) ** 2


def projections(gram: Array, across: Array, options: list[Option]) -> tuple[Array, Array]:
    """(ranks, squared lengths) of a signal's parts in each option's columns; batched by their number."""
    ranks, lengths = np.zeros(len(options)), np.zeros(len(options))
    sizes = np.array([len(option.columns) for option in options])
    for k in np.unique(sizes):
        chosen = np.flatnonzero(sizes == k)
        index = np.array([options[i].columns for i in chosen])
        blocks = gram[index[:, :, None], index[:, None, :]]
        diagonal = np.einsum("ijj->ij", blocks)
        scale = np.where(diagonal > 0, 1 / np.sqrt(np.maximum(diagonal, 1e-300)), 0)
        values, vectors = np.linalg.eigh(blocks * scale[:, :, None] * scale[:, None, :])
        along = np.einsum("ijk,ij->ik", vectors, across[index] * scale)
        keep = values > 1e-6
        ranks[chosen] = keep.sum(axis=1)
        lengths[chosen] = np.sum(np.where(keep, along**2 / np.where(keep, values, 1), 0), axis=1)
    return ranks, lengths


def ln_bayes(ranks: Array, lengths: Array) -> Array:
    """ln B of each option, over the ladder of d."""
    k = np.maximum(ranks, 1)
    g = _D2[:, None] / k
    ln = logsumexp(-k / 2 * np.log1p(g) + g / (1 + g) * lengths / 2, axis=0) - np.log(len(_D2))
    return np.where(ranks > 0, ln, -np.inf)


def by_effect(options: list[Option], ln_b: Array) -> dict[str, float]:
    """ln B of each effect: its options averaged."""
    terms: dict[str, list[float]] = {}
    for option, ln in zip(options, ln_b, strict=True):
        terms.setdefault(option.effect, []).append(ln + np.log(option.weight))
    return {name: float(logsumexp(one)) for name, one in terms.items()}


def _deterministic(options: list[Option], gram: Array, across: Array) -> Array:
    ln_b = ln_bayes(*projections(gram, across, options))
    for i, option in enumerate(options):
        if option.effect == "stand.earth_rate":  # its amplitude is known
            column = option.columns[0]
            if gram[column, column] > 0:
                ln_b[i] = across[column] - gram[column, column] / 2
    return ln_b


def judged(case: "Case", test: Excitation, catalogue: Catalogue) -> dict[str, Any]:
    """The oracle's verdict and the bounds that go with it, for the label."""
    if case.discrete:
        return {"ranking": [case.discrete], "class": [case.discrete], "ln_b": {case.discrete: 1e3}}
    signals = {}
    for channel in case.metric.channels:
        parts = [hidden.signal[channel] for hidden in case.hidden if channel in hidden.signal]
        signals[channel] = np.stack([sum(parts, np.zeros(test.rows)), case.noise[channel]], axis=1)
    gram, across, own = catalogue.gram(case.metric, signals)
    options = [option for option in catalogue.options if option.effect not in case.without]
    ln_options = _deterministic(options, gram, across.sum(axis=1))
    together = {channel: x.sum(axis=1) for channel, x in signals.items()}
    ln_b = by_effect(options, ln_options)
    if case.spec.kind != "semi_real":  # there nobody knows which noise is the unit's own
        ln_b |= _of_noise(case, test, together)
    ranking = sorted(ln_b, key=lambda name: -ln_b[name])
    facts: dict[str, Any] = {
        "ranking": ranking[:5],
        "ln_b": {name: ln_b[name] for name in ranking[:5]},
        "ln_odds_of_a_gap": float(logsumexp(list(ln_b.values())) - np.log(len(ln_b))),
        "class": _confusable(options, gram, across[:, 0], own[0, 0], case.hidden),
    }
    if len(case.hidden) == 2:
        facts |= _best_set(options, gram, across.sum(axis=1), ln_options, ln_b)
    if case.spec.kind in ("single", "decoy_stand") and case.hidden[0].signal:
        facts |= _bounds(case, test)
        rates = information_rates(case.hidden[0], tuple(facts["class"]), case.unit.noise)
        facts["next_tests"] = rates
        facts |= _baselines(case, test, catalogue, options, together)
    return facts


def _confusable(
    options: list[Option], gram: Array, across: Array, own: float, hidden: list[Hidden]
) -> list[str]:
    """Effects that cannot be told from the true one here: expected ln B = (d^2 - explained)/2 below 3."""
    truth = [one.facts["effect"] for one in hidden]
    if len(hidden) != 1 or own <= 0:
        return truth
    _, lengths = projections(gram, across, options)
    near = {o.effect for o, x in zip(options, lengths, strict=True) if (own - x) / 2 < CONFUSABLE_LN_B}
    return sorted(near | set(truth))


def _best_set(
    options: list[Option], gram: Array, across: Array, ln_options: Array, ln_b: dict[str, float]
) -> dict[str, Any]:
    """The most probable set of up to two effects: every second one beside the eight best first ones."""
    names = np.array([option.effect for option in options])
    sets = {(name,): ln for name, ln in ln_b.items()}
    ln_prior = LN_PRIOR_OF_A_SECOND - np.log(len(ln_b))
    for first in sorted(set(names), key=lambda name: -ln_b[name])[:8]:
        best = max(np.flatnonzero(names == first), key=lambda i: ln_options[i])
        index = np.array(options[best].columns)
        away = gram[:, index] @ np.linalg.pinv(gram[np.ix_(index, index)], rcond=1e-9, hermitian=True)
        rest, rest_across = gram - away @ gram[index], across - away @ across[index]
        rest[np.diag_indices_from(rest)] *= np.diag(rest) > 1e-6 * np.diag(gram)
        given = by_effect(options, _deterministic(options, rest, rest_across))
        for second, ln in given.items():
            if second != first:
                key = tuple(sorted((str(first), second)))
                sets[key] = max(sets.get(key, -np.inf), ln_b[first] + ln + ln_prior)
    ranking = sorted(sets, key=lambda key: -sets[key])
    return {"sets": [list(key) for key in ranking[:3]]}


def _bounds(case: "Case", test: Excitation) -> dict[str, Any]:
    """Cramér–Rao bounds of coefficients and phi, and the share of the gap that a fit can close."""
    hidden = case.hidden[0]
    shape = SHAPES.get(hidden.facts["effect"])
    runs, count = len(test.runs), 1
    bounds: list[float] = []
    if shape is not None and "coefficients" in hidden.facts:
        phi = hidden.facts["phi"]
        columns = _columns(case.metric, test, hidden, phi)
        if shape.range is not None:
            step = 1e-3 * phi
            values = np.concatenate([one["values"] for one in hidden.facts["coefficients"]])
            moved = _columns(case.metric, test, hidden, phi + step)
            columns = {c: np.column_stack([x, (moved[c] - x) @ values / step]) for c, x in columns.items()}
        gram = case.metric.gram(columns)
        scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        inverse = np.linalg.pinv(gram * np.outer(scale, scale), rcond=1e-9, hermitian=True)
        bounds = (scale * np.sqrt(np.maximum(np.diag(inverse), 0))).tolist()
        count = len(gram)
    share = (runs - 1) / runs if runs > 1 else 0.8
    return {"cramer_rao": bounds, "fraction_closed": max(0.0, 1 - count / (hidden.d**2 * share))}


def _columns(metric: Metric, test: Excitation, hidden: Hidden, phi: float) -> dict[str, Array]:
    """Channel to the columns of the true coefficients, in the label's order."""
    blocks = SHAPES[hidden.facts["effect"]].blocks(test, phi)
    wanted = [set(one["channels"]) for one in hidden.facts["coefficients"]]
    chosen = [block for names in wanted for block in blocks if set(block) == names]
    sizes = [next(iter(block.values())).shape[1] for block in chosen]
    columns: dict[str, Array] = {}
    for number, block in enumerate(chosen):
        for channel, x in block.items():
            if channel in metric.channels:
                wide = columns.setdefault(channel, np.zeros((test.rows, sum(sizes))))
                start = sum(sizes[:number])
                wide[:, start : start + sizes[number]] = x
    return columns


def _baselines(
    case: "Case", test: Excitation, catalogue: Catalogue, options: list[Option], y: dict[str, Array]
) -> dict[str, Any]:
    """First three by BIC with n = samples: whitened by what is believed, and not whitened at all."""
    plain = {c: ChannelNoise(n.rate_hz, n.white, ()) for c, n in case.unit.believed_noise.items()}
    found = {}
    for name, noise in (("bic", case.unit.believed_noise), ("unwhitened", plain)):
        columns = {channel: wave[:, None] for channel, wave in y.items()}
        gram, across, own = catalogue.gram(Metric(test, noise), columns)
        ranks, lengths = projections(gram, across[:, 0], options)
        n = test.rows * len(noise)
        bic = n * np.log(np.maximum(own[0, 0] - lengths, 1e-9) / n) + ranks * np.log(n)
        best: dict[str, float] = {}
        for option, value, rank in zip(options, bic, ranks, strict=True):
            if rank:
                best[option.effect] = min(best.get(option.effect, np.inf), value)
        found[name] = sorted(best, key=lambda effect: best[effect])[:3]
    return {"baselines": found}


# Effects that are noise or lines.


@dataclass
class _Spectrum:
    """A channel's whitened residual: power by frequency bins, and the lines of its Fourier transform."""

    angular: Array
    counts: Array
    power: Array
    lines: Array


def _spectrum(residual: Array, parts: list[slice]) -> _Spectrum:
    longest = max(part.stop - part.start for part in parts)
    edges = np.concatenate([np.geomspace(0.9 * np.pi / longest, np.pi * (1 + 1e-9), 121)])
    counts, power = np.zeros(120), np.zeros(120)
    lines: Array | float = 0.0
    for part in parts:
        n = part.stop - part.start
        own = np.pi * np.arange(1, n) / n
        squares = np.asarray(dct(residual[part], norm="ortho"))[1:] ** 2
        counts += np.histogram(own, edges)[0]
        power += np.histogram(own, edges, weights=squares)[0]
        lines = lines + 2 * np.abs(np.asarray(rfft(residual[part], 2 * longest))) ** 2 / n
    filled = counts > 0
    centre = np.sqrt(edges[1:] * edges[:-1])
    return _Spectrum(centre[filled], counts[filled], power[filled], np.asarray(lines))


def _of_noise(case: "Case", test: Excitation, y: dict[str, Array]) -> dict[str, float]:
    """ln B of noise effects and lines."""
    spectra = {}
    for channel, inner in case.metric.channels.items():
        residual = inner.residual(inner.whitened(y[channel][:, None]))[:, 0]
        spectra[channel] = _spectrum(residual, test.slices())
    tables = {channel: _level_table(case, channel, one) for channel, one in spectra.items()}
    ln_b = {}
    for name, (triad, part) in STOCHASTIC.items():
        if TRIADS[triad][0] in tables:
            ln_b[name] = _over_axes(
                [tables[channel][part] for channel in TRIADS[triad]], levels=part != "walk"
            )
    rate = test.runs[0].rate_hz
    for name in LINES:
        channels = TRIADS["mag" if name == "mag.mains_interference" else "gyro"]
        if channels[0] in spectra:
            ln_b[name] = _line(np.array([spectra[c].lines for c in channels]), len(test.runs), rate, name)
    return {name: value for name, value in ln_b.items() if name not in case.without}


def _over_axes(tables: list[Array], *, levels: bool) -> float:
    """One axis (0.6) or all with the same amount (0.4); each table is ln B by amount.

    A louder level gains by what its unlikeliness costs, and the levels of a triad are mostly common: all
    axes together then gain no more than one.
    """
    count = len(tables[0])
    single = [logsumexp(table) - np.log(count) + np.log(0.6 / len(tables)) for table in tables]
    every = sum(tables) / (len(tables) if levels else 1)
    return float(logsumexp([*single, logsumexp(every) - np.log(count) + np.log(0.4)]))


def _level_table(case: "Case", channel: str, seen: _Spectrum) -> dict[str, Array]:
    """ln B by amount of louder white noise, louder slow noise, and of a random walk."""
    believed = case.unit.believed_noise[channel]
    spread_white, spread_slow = case.unit.spreads[channel.split("_")[0]]
    total = case.unit.noise[channel].spectrum(seen.angular)
    white = np.full_like(total, believed.white**2)
    slow = believed.spectrum(seen.angular) - white
    ln_ratio = np.linspace(-6, 6, 61)
    walks = np.concatenate([[0], np.geomspace(1e-5, 0.3, 20)])
    walk = ChannelNoise(believed.rate_hz, 0.0, (), 1.0).spectrum(seen.angular) * white
    shapes = (white + np.exp(2 * ln_ratio)[:, None] * slow)[:, None] + (walks**2)[:, None] * walk
    ratio = shapes / total
    n = seen.counts.sum()
    level = np.sum(seen.power / ratio, axis=-1) / n
    ln = -0.5 * (n * np.log(level) + np.sum(seen.counts * np.log(ratio), axis=-1))
    z_white = 0.5 * np.log(level) / spread_white
    z_slow = (0.5 * np.log(level) + ln_ratio[:, None]) / spread_slow * (1.0 if believed.terms else 0.0)

    def posterior(white_more: float, slow_more: float) -> Array:
        z = (z_white - white_more / spread_white) ** 2 + (z_slow - slow_more / spread_slow) ** 2
        return np.asarray(logsumexp(ln - z / 2, axis=0))

    base = posterior(0.0, 0.0)
    amounts = np.linspace(0.3, np.log(MAX_FACTOR), 12)
    return {
        "white": np.array([posterior(a, 0.0)[0] for a in amounts]) - base[0],
        "slow": np.array([posterior(0.0, a)[0] for a in amounts]) - base[0],
        "walk": base[1:] - base[0],
    }


def _line(lines: Array, runs: int, rate: float, name: str) -> float:
    """ln B of a line at an unknown frequency; `lines` (3, frequencies) sum over runs."""
    cycles = np.linspace(0, 0.5, lines.shape[1])
    near = (cycles > 0.04) & (cycles < 0.49)
    if name == "mag.mains_interference":
        folded = abs(50 / rate - np.round(50 / rate))
        near = np.abs(cycles - folded) < 0.05 / rate + cycles[1]
    one = [np.log(0.6 / 3) + ln_bayes(np.full(near.sum(), 2.0 * runs), line[near]) for line in lines]
    every = np.log(0.4) + ln_bayes(np.full(near.sum(), 6.0 * runs), lines[:, near].sum(axis=0))
    return float(logsumexp([*one, every]) - np.log(near.sum()))
