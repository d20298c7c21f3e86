# pyright: strict
"""The quantum that a triad's samples really have: the lattice on which all values lie.

The least distances of the different values give a first quantum; it is sharpened over ever longer ones, each
a whole number of quanta, until it spans them all. Values that are no lattice leave phases spread evenly,
1/√12 of the quantum that would be; what text or float32 rounds off a lattice leaves less.

A lattice is a finding if it is coarser than believed, or, where nothing is believed, if q²/12 adds to the
white noise: rounding to six digits makes a lattice too, and changes nothing.
"""

import math
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import SI_UNIT, FloatArray, SensorName
from gap_diagnosis.observation import AXES, TimingFinding

LEAST_SAMPLES = 100
ROUNDING = 1e-9
"""Of the largest value: distances below are rounding."""
MAX_VALUES = 50_000
LEAST_GAPS = 20
FIRST_REACH, LONGER = 8.0, 8.0
LARGEST_PHASE = 0.05
"""Deviation of values from whole quanta, in quanta."""
EVEN_PHASE = 12.0**-0.5
COARSER = 1.5
"""Times the believed quantum."""
LEAST_SHARE, LEAST_UNBELIEVED_SHARE = 1e-4, 0.05
"""Of the samples' noise variance: what q²/12 must be beside it."""
MAX_LOG_RATIO = 1e6


@dataclass(frozen=True)
class Lattice:
    """`quantum_si` with its standard uncertainty; `log_likelihood_ratio` against values between."""

    quantum_si: float
    standard_uncertainty_si: float
    log_likelihood_ratio: float


def lattice_of(values: FloatArray) -> Lattice | None:
    """The lattice of one channel's (n,) values, NaN left out; None: they lie on none."""
    there = values[np.isfinite(values)]
    if len(there) < LEAST_SAMPLES:
        return None
    different = np.unique(there[:MAX_VALUES])
    if len(different) > LEAST_GAPS:  # the ends of a range need not lie on the lattice
        different = different[1:-1]
        there = there[(there >= different[0]) & (there <= different[-1])]
    gaps = np.diff(different)
    gaps = gaps[gaps > ROUNDING * float(np.abs(different).max(initial=0.0))]
    if not len(gaps) or (len(gaps) < LEAST_GAPS and len(gaps) > 0.2 * len(there)):
        return None
    quantum = _spanning(gaps)
    if quantum is None:
        return None
    codes: FloatArray = np.rint((there - different[0]) / quantum)
    off: FloatArray = (there - different[0]) / quantum - codes
    off -= off.mean()
    phase = max(math.sqrt(float(np.mean(off**2))), 1e-6)
    if phase > LARGEST_PHASE or np.ptp(codes) < 1:
        return None
    ratio = len(there) * math.log(EVEN_PHASE / phase)
    uncertainty = quantum * phase / (float(codes.std()) * math.sqrt(len(there)))
    return Lattice(quantum, uncertainty, min(ratio, MAX_LOG_RATIO))


def _spanning(gaps: FloatArray) -> float | None:
    """The quantum of which all gaps are whole multiples, sharpened from the short ones to the long ones."""
    least = np.sort(gaps)[: max(1, len(gaps) // 100)]
    quantum = float(np.median(least))
    reach = FIRST_REACH
    while True:
        few = gaps[gaps < reach * quantum]
        codes = np.rint(few / quantum)
        if not codes.sum() or np.sqrt(np.mean((few / quantum - codes) ** 2)) > 2.0 * LARGEST_PHASE:
            return None
        quantum = float((codes * few).sum() / (codes**2).sum())
        if len(few) == len(gaps):
            break
        reach *= LONGER
    # over all at once: positions are sums of whole gaps
    total = np.rint(gaps / quantum).sum()
    return float(gaps.sum() / total)


def sample_noise(values: FloatArray) -> float:
    """Standard deviation of what neighbours do not share, (n,) → SI; robust against motion."""
    third = values[3:] - 3.0 * values[2:-1] + 3.0 * values[1:-2] - values[:-3]
    third = third[np.isfinite(third)]
    return 1.4826 * float(np.median(np.abs(third))) / math.sqrt(20.0) if len(third) else 0.0


def coarse_lattice(
    sensor: SensorName, values_si: FloatArray, believed_si: float
) -> tuple[float, TimingFinding | None]:
    """The triad's quantum as seen (0: none seen), and the finding where the belief says less.

    Args:
        sensor: the triad.
        values_si: (n, 3) as sent.
        believed_si: the believed quantum; 0: none.
    """
    seen: dict[int, Lattice] = {}
    for axis in range(values_si.shape[1]):
        lattice = lattice_of(values_si[:, axis])
        if lattice is None:
            continue
        noise = sample_noise(values_si[:, axis])  # with the lattice's own
        own = lattice.quantum_si**2 / 12.0
        share = own / max(noise**2 - own, 0.1 * own)
        least = LEAST_SHARE if believed_si > 0 else LEAST_UNBELIEVED_SHARE
        if lattice.quantum_si > COARSER * believed_si and share > least:
            seen[axis] = lattice
    if not seen:
        return 0.0, None
    best = min(seen.values(), key=lambda one: one.standard_uncertainty_si)
    names = ", ".join(f"{sensor}_{AXES[axis]}" for axis in seen)
    believed = f"; believed is {believed_si:.4g}" if believed_si > 0 else ""
    unit = SI_UNIT[sensor]
    said = f"All values of {names} are whole multiples of {best.quantum_si:.5g} {unit}{believed}."
    finding = TimingFinding(
        f"{sensor}.quantization",
        (sensor,),
        "quantum_si",
        best.quantum_si,
        max(best.standard_uncertainty_si, ROUNDING * best.quantum_si),
        unit,
        min(sum(one.log_likelihood_ratio for one in seen.values()), MAX_LOG_RATIO),
        said,
        channels=tuple(f"{sensor}_{AXES[axis]}" for axis in seen),
    )
    return best.quantum_si, finding
