# pyright: strict
"""The search for spectral lines: what the motion leaves, its periodogram, and what makes a line one.

See `spectral_lines` for what counts.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, gammaincc  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.line_residuals import LineResiduals, SensorChannel

ComplexArray = NDArray[np.complex128]
Float32Array = NDArray[np.float32]

LEAST_CYCLES = 8.0
"""In the longest recording: what is slower is slow noise."""
MAX_LINES, MAX_REFUSED = 6, 40
LEAST_LOG_RATIO = 6.0
"""−ln p, family-wise."""
LEAST_OWN_GAIN = 5.0
"""A channel is part of a line if it has so much of its own."""
NARROWEST, WIDEST = 16, 1024
"""Independent frequencies in a band of the background."""
OVERSAMPLED = 2.5
"""Lines between the independent frequencies: so many more tries."""
PARTS = 6
LEAST_OF_A_PART, LARGEST_CONDITION = 8, 1e3
LEAST_P_OF_PARTS, UNLIKE_SHARE = 1e-3, 0.25
LINE_OF_EXCITATION = 25.0
"""Power over the background."""
NOTHING = 1e-20
"""Of a series' power: rounding."""
MAX_HARMONIC = 400
EXPECTED_WITHIN_HZ = 0.02


@dataclass(frozen=True)
class Line:
    """A tone.

    Attributes:
        sensor, axes: where it is.
        frequency_hz, frequency_uncertainty_hz: as sampled, below half the sampling rate.
        amplitude_si: (3,) root mean square over the recordings of its amplitude; 0 on other axes.
        amplitude_uncertainty_si: (3,).
        log_ratio: −ln p, family-wise.
    """

    sensor: SensorName
    axes: tuple[int, ...]
    frequency_hz: float
    frequency_uncertainty_hz: float
    amplitude_si: tuple[float, float, float]
    amplitude_uncertainty_si: tuple[float, float, float]
    log_ratio: float


@dataclass(frozen=True)
class _Fit:
    """A tone in one channel of one recording: (2,) amplitudes, the noise's variance a sample, samples."""

    number: int
    channel: SensorChannel
    amplitudes: FloatArray
    variance: float
    count: int

    @property
    def signal(self) -> float:
        """d² = n A² / (2 σ²)."""
        return float(self.amplitudes @ self.amplitudes) * self.count / (2.0 * self.variance)


class LineSearch:
    """The periodograms of all recordings on one frequency grid.

    Lines of a magnetometer are looked for at `expected_hz` first: few frequencies, few tries.
    """

    def __init__(
        self, parts: Sequence[LineResiduals], period_s: float, expected_hz: Sequence[float] = ()
    ) -> None:
        self.parts = parts
        self.expected_hz = expected_hz
        self.period_s = period_s
        longest = max((int(part.place[-1]) + 1 for part in parts), default=2)
        self.size = 1 << (2 * longest - 1).bit_length()
        self.longest = longest
        self.frequency_hz = np.arange(self.size // 2 + 1) / (self.size * period_s)
        self.per_line = self.size / longest
        self.powers: dict[tuple[int, SensorChannel], Float32Array] = {}
        self.excited = [self._lines_of_excitation(part) for part in parts]
        self.open = np.ones(len(self.frequency_hz), dtype=bool)
        first = math.ceil(LEAST_CYCLES * self.per_line)
        self.open[:first] = False
        self.open[-math.ceil(self.per_line) :] = False
        for number, part in enumerate(parts):
            for channel in part.left:
                self._renew(number, channel)

    def _spectrum(self, part: LineResiduals, values: FloatArray) -> ComplexArray:
        even = np.zeros(self.size)
        even[part.place] = values
        return np.fft.rfft(even)

    def _renew(self, number: int, channel: SensorChannel) -> None:
        part = self.parts[number]
        power = np.abs(self._spectrum(part, part.left[channel])) ** 2
        background, telling = self._background(power)
        self.powers[number, channel] = np.stack([power / background, telling]).astype(np.float32)

    def _background(self, power: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean of the noise's power at each line, and how many independent lines tell it."""
        edges, width = [1], NARROWEST
        while edges[-1] < len(power) - 1:
            step = round(width * self.per_line)
            edges.append(min(edges[-1] + step, len(power) - 1))
            width = min(max(width, int(0.5 * edges[-1] / self.per_line)), WIDEST)
        if len(edges) > 2 and edges[-1] - edges[-2] < NARROWEST * self.per_line:
            edges.pop(-2)
        middle = np.array([0.5 * (a + b) for a, b in itertools.pairwise(edges)])
        median = [float(np.median(power[a:b])) for a, b in itertools.pairwise(edges)]
        count = np.array([(b - a) / self.per_line for a, b in itertools.pairwise(edges)])
        k = np.arange(len(power))
        level = np.exp(np.interp(k, middle, np.log(np.maximum(median, 1e-300)))) / math.log(2.0)
        return np.maximum(level, 1e-300), np.maximum(0.48 * np.interp(k, middle, count), 4.0)

    def _groups(self) -> list[tuple[SensorName, tuple[int, ...]]]:
        """Channels alone, then those of a triad together."""
        alone: set[SensorChannel] = {channel for part in self.parts for channel in part.left}
        by_sensor: dict[SensorName, tuple[int, ...]] = {}
        for sensor, axis in sorted(alone):
            by_sensor[sensor] = (*by_sensor.get(sensor, ()), axis)
        groups: list[tuple[SensorName, tuple[int, ...]]] = [(sensor, (axis,)) for sensor, axis in alone]
        return sorted(groups) + [(s, axes) for s, axes in by_sensor.items() if len(axes) > 1]

    def lines(self) -> Iterator[Line]:
        """The clearest first, each taken off before the next is looked for."""
        groups, every = self._groups(), self.open.copy()
        expected = np.zeros_like(self.open)
        for frequency in self.expected_hz:
            at = round(frequency * self.size * self.period_s)
            width = math.ceil(EXPECTED_WITHIN_HZ * self.size * self.period_s) + math.ceil(self.per_line)
            expected[max(at - width, 0) : at + width + 1] = True
        yield from self._lines_at([group for group in groups if group[0] == "mag"], every & expected)
        yield from self._lines_at(groups, every)

    def _lines_at(
        self, groups: Sequence[tuple[SensorName, tuple[int, ...]]], among: NDArray[np.bool_]
    ) -> Iterator[Line]:
        """The same, of these channels and frequencies."""
        gains = {group: self._gain(group) for group in groups}
        tries = OVERSAMPLED * float(among.sum()) / self.per_line * len(groups)
        if not groups or tries < 1.0:
            return
        self.open = among.copy()
        found = refused = 0
        while found < MAX_LINES and refused < MAX_REFUSED:
            best = max(((self._best(*gains[group]), group) for group in groups), key=lambda item: item[0][0])
            (log_ratio, index), (sensor, axes) = best
            log_ratio -= math.log(tries)
            if log_ratio < LEAST_LOG_RATIO:
                return
            if not self._counts(sensor, axes, index):
                self._close(index)
                refused += 1
                continue
            yield self._taken_off(sensor, axes, index, log_ratio)
            found += 1
            for group in groups:
                if group[0] == sensor:
                    gains[group] = self._gain(group)

    def _gain(self, group: tuple[SensorName, tuple[int, ...]]) -> tuple[FloatArray, FloatArray, int]:
        """Sum of powers over the background, what tells the background, and how many were summed."""
        sensor, axes = group
        total, telling, count = np.zeros(len(self.frequency_hz)), np.zeros(len(self.frequency_hz)), 0
        for (_, channel), (power, tells) in self.powers.items():
            if channel[0] == sensor and channel[1] in axes:
                total += power
                telling += tells
                count += 1
        return total, telling / max(count, 1), count

    def _best(self, total: FloatArray, telling: FloatArray, count: int) -> tuple[float, int]:
        """−ln p of the largest open line, and which it is."""
        if not count:
            return 0.0, 0
        near = np.where(self.open, total, 0.0)
        few = np.argpartition(near, -64)[-64:]
        p = betainc(telling[few], float(count), telling[few] / (telling[few] + near[few]))
        place = int(few[int(np.argmin(p))])
        return -math.log(max(float(np.min(p)), 1e-280)), place

    def _close(self, index: int) -> None:
        width = math.ceil(2.0 * self.per_line)
        self.open[max(index - width, 0) : index + width + 1] = False

    def _counts(self, sensor: SensorName, axes: tuple[int, ...], index: int) -> bool:
        if any(self._is_excited(number, index) for number in range(len(self.parts))):
            return False
        return self._lasts(sensor, axes, self._refined(sensor, axes, float(self.frequency_hz[index])))

    def _lines_of_excitation(self, part: LineResiduals) -> Float32Array:
        """Largest power over the background among the series that moved, on the search's grid."""
        largest = np.zeros(len(self.frequency_hz), dtype=np.float32)
        for series in part.excitation():
            power = np.abs(self._spectrum(part, series)) ** 2
            level = self._background(power)[0] + NOTHING * float(power.sum())
            np.maximum(largest, power / level, out=largest, casting="same_kind")
        return largest

    def _is_excited(self, number: int, index: int) -> bool:
        """The excitation has a line there, or a gimbal turns at a whole fraction of it."""
        part, frequency_hz = self.parts[number], float(self.frequency_hz[index])
        resolution = 1.0 / part.length_s
        for turning in part.rotations_hz:
            harmonic = round(frequency_hz / turning)
            apart = abs(frequency_hz - harmonic * turning)
            if 1 <= harmonic <= MAX_HARMONIC and turning > 4.0 * resolution and apart < 2.0 * resolution:
                return True
        width = math.ceil(2.0 * resolution * self.size * self.period_s)
        near = self.excited[number][max(index - width, 0) : index + width + 1]
        return bool(near.max() > LINE_OF_EXCITATION)

    def _waves(self, part: LineResiduals, frequency_hz: float, rows: Any) -> FloatArray:
        phase = 2.0 * np.pi * frequency_hz * (part.time_s[rows] - part.time_s[0])
        return np.stack([np.cos(phase), np.sin(phase)], axis=1)

    def _fits(self, sensor: SensorName, axes: tuple[int, ...], frequency_hz: float) -> list[_Fit]:
        """In every recording that has the channel."""
        found: list[_Fit] = []
        for number, part in enumerate(self.parts):
            for axis in axes:
                channel: SensorChannel = (sensor, axis)
                if channel in part.left:
                    rows = part.known[channel]
                    x = self._waves(part, frequency_hz, rows)
                    amplitudes = np.linalg.solve(x.T @ x, x.T @ part.left[channel][rows]).astype(np.float64)
                    variance = self._variance(number, channel, frequency_hz)
                    found.append(_Fit(number, channel, amplitudes, variance, int(rows.sum())))
        return found

    def _variance(self, number: int, channel: SensorChannel, frequency_hz: float) -> float:
        """Of white noise of the density there is around the line."""
        part = self.parts[number]
        index = round(frequency_hz * self.size * self.period_s)
        near = slice(max(index - math.ceil(64 * self.per_line), 1), index + math.ceil(64 * self.per_line))
        power = np.abs(self._spectrum(part, part.left[channel])[near]) ** 2
        return float(np.median(power)) / math.log(2.0) / max(int(part.known[channel].sum()), 1)

    def _refined(self, sensor: SensorName, axes: tuple[int, ...], frequency_hz: float) -> float:
        """The frequency of the largest gain, by parabolas."""
        width = 0.35 / max(part.length_s for part in self.parts)
        fits = self._fits(sensor, axes, frequency_hz)

        def gain(f: float) -> float:
            total = 0.0
            for fit in fits:
                part = self.parts[fit.number]
                rows = part.known[fit.channel]
                cross = self._waves(part, f, rows).T @ part.left[fit.channel][rows]
                total += float(cross @ cross) / (fit.count * fit.variance)
            return total

        for _ in range(3):
            low, middle, high = gain(frequency_hz - width), gain(frequency_hz), gain(frequency_hz + width)
            curve = low - 2.0 * middle + high
            if curve < 0:
                step = 0.5 * (low - high) / curve
                frequency_hz += width * min(max(step, -1.0), 1.0)
            width *= 0.4
        return frequency_hz

    def _lasts(self, sensor: SensorName, axes: tuple[int, ...], frequency_hz: float) -> bool:
        """Alike in all parts of each recording."""
        unlike = gained = 0.0
        freedom = 0
        for fit in self._fits(sensor, axes, frequency_hz):
            part = self.parts[fit.number]
            rows = np.flatnonzero(part.known[fit.channel])
            for some in np.array_split(rows, PARTS):
                x = self._waves(part, frequency_hz, some)
                gram = x.T @ x
                if len(some) < LEAST_OF_A_PART or np.linalg.cond(gram) > LARGEST_CONDITION:
                    continue
                off = np.linalg.solve(gram, x.T @ part.left[fit.channel][some]) - fit.amplitudes
                unlike += float(off @ gram @ off) / fit.variance
                gained += float(fit.amplitudes @ gram @ fit.amplitudes) / fit.variance
                freedom += 2
            freedom -= 2
        if freedom <= 0:
            return True
        p = float(gammaincc(0.5 * freedom, 0.5 * unlike))  # pyright: ignore[reportUnknownArgumentType]
        return p > LEAST_P_OF_PARTS or unlike - freedom < UNLIKE_SHARE * gained

    def _taken_off(self, sensor: SensorName, axes: tuple[int, ...], index: int, log_ratio: float) -> Line:
        frequency = self._refined(sensor, axes, float(self.frequency_hz[index]))
        fits = self._fits(sensor, axes, frequency)
        gain = [0.5 * sum(fit.signal for fit in fits if fit.channel[1] == axis) for axis in range(3)]
        mine = tuple(axis for axis in axes if gain[axis] > LEAST_OWN_GAIN) or axes
        size, uncertainty, precision = [0.0] * 3, [0.0] * 3, 0.0
        for axis in mine:
            own = [fit for fit in fits if fit.channel[1] == axis]
            size[axis] = math.sqrt(sum(float(fit.amplitudes @ fit.amplitudes) for fit in own) / len(own))
            uncertainty[axis] = sum(fit.count / (2.0 * fit.variance) for fit in own) ** -0.5
            precision += sum(fit.signal * self.parts[fit.number].length_s ** 2 for fit in own)
        for fit in fits:
            if fit.channel[1] not in mine:
                continue
            part = self.parts[fit.number]
            tone = self._waves(part, frequency, np.arange(len(part.time_s))) @ fit.amplitudes
            part.removed[fit.channel] = part.removed.get(fit.channel, 0.0) + tone
            part.left[fit.channel] = np.where(part.known[fit.channel], part.left[fit.channel] - tone, 0.0)
            self._renew(fit.number, fit.channel)
        frequency_u = math.sqrt(12.0 / max(precision, 1e-300)) / (2.0 * math.pi)
        return Line(
            sensor,
            mine,
            frequency,
            frequency_u,
            (size[0], size[1], size[2]),
            (uncertainty[0], uncertainty[1], uncertainty[2]),
            log_ratio,
        )
