# pyright: strict
"""What the steps of a diagnosis found, and white noise beyond belief, which none of them searched for."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gap_diagnosis.attribution import Attribution
from gap_diagnosis.design import NUISANCES
from gap_diagnosis.fitting import JointFit
from gap_diagnosis.held_out import HeldOut
from gap_diagnosis.jumps import Jump
from gap_diagnosis.localisation import Localisation
from gap_diagnosis.noise_model import white_noise_of_rows, without_columns
from gap_diagnosis.observation import Channel, Observation, Oddity, TimingFinding
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.rivals import Rival
from gap_diagnosis.search import Search

SIGNIFICANT_P = 0.05
LARGEST_FACTOR = 30.0
EXPECTED_CLAIMS = 0.05
"""Prior number of triads whose white noise is beyond its spread: it is claimed beside whatever else acts."""
FIELD: Mapping[str, tuple[str, float]] = {
    "gyro": ("deg/s", math.pi / 180.0),
    "acc": ("m/s^2", 1.0),
    "mag": ("uT", 1e-6),
    "temperature": ("degC", 1.0),
    "gnss": ("m", 1.0),
}
WHITE_NAMES = {"gyro": "gyro.angle_random_walk", "acc": "acc.velocity_random_walk", "mag": "mag.white_noise"}


def field_of(channel: Channel, observations: Sequence[Observation]) -> tuple[str, float]:
    """The unit that people read a channel in, and what one of it is in SI; '1' for plain numbers."""
    for one in observations:
        output = one.outputs.get(channel.sensor)
        if output is not None and output.norm is not None and output.norm.unit is not None:
            return output.norm.unit
    return FIELD[channel.sensor]


@dataclass(frozen=True)
class Findings:
    """All that the steps found; see `diagnosis`."""

    prepared: Prepared
    located: Localisation
    search: Search
    attribution: Attribution
    fit: JointFit | None
    held: HeldOut | None
    left: Localisation | None
    timing: tuple[TimingFinding, ...]
    without: frozenset[str]
    rivals: tuple[Rival, ...] = ()
    jumps: tuple[Jump, ...] = ()
    oddities: tuple[Oddity, ...] = ()


@dataclass(frozen=True)
class NoiseClaim:
    """White noise beyond belief."""

    name: str
    probability: float
    channels: tuple[Channel, ...]


def noise_claims(found: Findings) -> list[NoiseClaim]:
    """White noise beyond the spread that the belief allows: of a triad as a whole, or of one axis."""
    claims: list[NoiseClaim] = []
    threshold = math.log(max(found.search.effects, 1) / EXPECTED_CLAIMS)
    for sensor, name in WHITE_NAMES.items():
        if name in found.without:
            continue
        ratios = {
            channel: noise.log_white_ratio + taken_off(found.fit, channel)
            for channel, noise in found.prepared.noise.items()
            if channel.sensor == sensor and noise.log_white_ratio is not None
        }
        if not ratios:
            continue
        spread = found.prepared.noise[next(iter(ratios))].belief.white_spread
        evidence, channels = white_excess(ratios, spread)
        if evidence > threshold:
            probability = 1.0 / (1.0 + math.exp(-min(evidence - threshold, 600.0)))
            claims.append(NoiseClaim(name, probability, channels))
    return sorted(claims, key=lambda claim: -claim.probability)


def taken_off(fit: JointFit | None, channel: Channel) -> float:
    """ln of a channel's white noise without the fitted effects over that with them: 0 or less.

    An effect of a hundred times the noise changes from row to row by more than the noise does.
    """
    if fit is None or channel not in fit.prepared.design.channels:
        return 0.0
    design = fit.prepared.design.channels[channel]
    before = after = 0.0
    for index, matrix in design.matrices.items():
        output = fit.prepared.observations[index].outputs[channel.sensor]
        residual = output.residual_si[design.rows[index], channel.axis]
        before += len(residual) * white_noise_of_rows(without_columns(residual, matrix[:, :NUISANCES])) ** 2
        after += len(residual) * white_noise_of_rows(without_columns(residual, matrix)) ** 2
    return min(0.5 * math.log(after / before), 0.0) if after > 0.0 and before > 0.0 else 0.0


def white_excess(log_ratios: Mapping[Channel, float], spread: float) -> tuple[float, tuple[Channel, ...]]:
    """ln B of more white noise than believed, by any factor up to `LARGEST_FACTOR`, and on which axes.

    Axes are taken for independent: a belief does not say how far they go together.
    """
    values = list(log_ratios.values())

    def of(excess: float, deviation: float) -> float:
        if excess <= 0.0:
            return -math.inf
        flat = math.log(math.log(LARGEST_FACTOR))
        return 0.5 * (excess / deviation) ** 2 + math.log(deviation * math.sqrt(2.0 * math.pi)) - flat

    best = of(sum(values) / len(values), spread), tuple(log_ratios)
    for channel, value in log_ratios.items():
        others = [v for c, v in log_ratios.items() if c != channel]
        if not others:
            continue
        alone = of(value - sum(others) / len(others), spread * math.sqrt(1.0 + 1.0 / len(others)))
        alone -= math.log(len(values))
        if alone > best[0]:
            best = alone, (channel,)
    return best


def certain_oddities(found: Findings) -> list[Oddity]:
    """Those that no effect of the catalogue can be the cause of, whatever else acts."""
    return [one for one in found.oddities if one.is_certain]


def alike(finding: TimingFinding) -> list[str]:
    """A filter's lag delays as a link does."""
    lags = [f"{sensor}.bandwidth" for sensor in finding.sensors if sensor != "mag"]
    return lags if finding.effect == "link.fixed_delay" else []
