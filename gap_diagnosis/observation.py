# pyright: strict
"""A recording as the diagnosis sees it: what acted, what the unit said, what the belief predicts, all in SI.

One row is one sample of the unit, or the mean of a few (`samples_per_row`). The stimulus is the stand's own
report, brought to the unit's instants and to its nominal body axes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus

AXES = "xyz"


@dataclass(frozen=True)
class NoiseBelief:
    """What is believed of one triad's noise; None: nothing is.

    Attributes:
        white_si_per_sqrt_hz: density of the white noise (angle or velocity random walk).
        white_spread: standard deviation of the logarithm of its level over units.
        slow_deviation_si: standard deviation of the slow noise (Gauss–Markov).
        slow_correlation_time_s: its correlation time; None with `slow_coefficient_si`.
        slow_coefficient_si: the coefficient B of IEEE 952 where no correlation time is stated.
        slow_spread: as `white_spread`.
    """

    white_si_per_sqrt_hz: float | None = None
    white_spread: float = 0.3
    slow_deviation_si: float | None = None
    slow_correlation_time_s: float | None = None
    slow_coefficient_si: float | None = None
    slow_spread: float = 0.5


@dataclass(frozen=True)
class NormView:
    """A triad of which only the length of its vector is known (see `norms`): one channel, 'mag_norm'.

    Attributes:
        along: (n, 3) what an added output changes in the length.
        noise_si: standard deviation of a row.
        free: elements (i, j) of the matrix that a length tells.
        unit: of outputs in plain numbers, and what one of them was taken for in SI; None: they are in SI.
    """

    along: FloatArray
    noise_si: float
    free: tuple[tuple[int, int], ...]
    unit: tuple[str, float] | None = None

    def column(self, added: FloatArray) -> FloatArray:
        """(n, 4) of what is added to the outputs (n, 3): by axis, then to their length."""
        return np.column_stack([added, np.sum(self.along * added, axis=1)])


@dataclass(frozen=True)
class SensorOutput:
    """One triad's samples beside what the belief predicts.

    Attributes:
        values_si: (n, 3); NaN is a sample that is missing or must not be used (saturated, frozen).
        predicted_si: (n, 3) M u + b, behind the believed filter; NaN where the stand says nothing.
        noise: what is believed of it.
        quantum_si, range_si: as believed; 0 and infinity where nothing is.
        bandwidth_hz: of the believed filter, which `predicted_si` has passed; None: none.
        norm: None but for a triad that is seen by its norm alone: values and prediction then are (n, 4), NaN
            but for the last column.
    """

    values_si: FloatArray
    predicted_si: FloatArray
    noise: NoiseBelief
    quantum_si: float = 0.0
    range_si: float = float("inf")
    bandwidth_hz: float | None = None
    norm: NormView | None = None

    @property
    def residual_si(self) -> FloatArray:
        """(n, 3) values less prediction; NaN where either is missing."""
        return self.values_si - self.predicted_si


@dataclass(frozen=True)
class TimingFinding:
    """What the samples show by themselves: their times, their order, their values, their spectrum.

    Attributes:
        effect: name in the catalogue: link.fixed_delay, link.clock_drift, link.timestamp_jitter,
            link.frame_loss, link.duplicate_frames, link.counter_wrap, link.aliasing, mag.mains_interference,
            quantization and saturation of a triad.
        sensors: triads that it was seen on; empty: the whole frame.
        parameter, value, standard_uncertainty, unit: as the catalogue names it, SI.
        log_likelihood_ratio: against no such effect; large is certain.
        description: English, for people.
        more: further parameters: name, value, standard uncertainty, unit.
        channels: 'gyro_x', …, where it is not on all axes of its triads.
    """

    effect: str
    sensors: tuple[SensorName, ...]
    parameter: str
    value: float
    standard_uncertainty: float
    unit: str
    log_likelihood_ratio: float
    description: str
    more: tuple[tuple[str, float, float, str], ...] = ()
    channels: tuple[str, ...] = ()

    def is_on(self, channel: "Channel") -> bool:
        """Whether it was seen on this channel."""
        return channel.name in self.channels if self.channels else channel.sensor in self.sensors


@dataclass(frozen=True)
class Oddity:
    """What the samples show and no effect of the catalogue does: 'gyro_x holds its last value …'.

    Attributes:
        description: English.
        channel: 'gyro_x'.
        p: of chance, family-wise over what was looked at.
        is_certain: by itself, whatever else acts; otherwise it only describes what no effect explains.
    """

    description: str
    channel: str
    p: float
    is_certain: bool = True


@dataclass(frozen=True)
class SetAside:
    """Rows that the diagnosis does not use."""

    what: str
    count: int
    why: str


@dataclass(frozen=True)
class Observation:
    """One recording, ready to be diagnosed.

    Attributes:
        recording_id, serial, product, profile, run, mount, stand_id, stand_kind, site: as recorded, empty
            where not said.
        stimulus: what acted at the n rows; what was not recorded is None. `temperature_c` is the unit's own
            sensor where there is one, else the chamber's, else 25.
        has_temperature: False where `temperature_c` is a guess.
        outputs: by triad; only those with samples and a prediction. 'temperature' (column 0 of 3) where both
            unit and stand tell one: the unit's, predicted by the chamber's.
        usable: (n,) rows that the stand's report covers, no hole within a few periods.
        piece: (n,) int: rows of one number follow each other without a hole.
        sample_period_s: of the unit.
        samples_per_row: 1, or how many samples a row is the mean of.
        timing: what frames and counter show; delay, drift and jitter against the stand (see `timing`).
        aligned_by_s: added to the unit's clock where the two clocks' epochs are unrelated; 0: nothing.
        set_aside: what is not used.
        oddities: what the samples show and the catalogue has not.
        believed: recording.json's own object.
    """

    recording_id: str
    serial: str
    product: str
    profile: str
    run: str
    mount: str
    stand_id: str
    stand_kind: str
    stimulus: Stimulus
    has_temperature: bool
    outputs: Mapping[SensorName, SensorOutput]
    usable: NDArray[np.bool_]
    piece: NDArray[np.int64]
    sample_period_s: float
    samples_per_row: int = 1
    timing: tuple[TimingFinding, ...] = ()
    aligned_by_s: float = 0.0
    set_aside: tuple[SetAside, ...] = ()
    oddities: tuple[Oddity, ...] = ()
    site: Mapping[str, float] = field(default_factory=dict[str, float])
    believed: Mapping[str, object] = field(default_factory=dict[str, object])

    def __len__(self) -> int:
        return len(self.stimulus.time_s)


ChannelKind = Literal["deterministic", "stochastic", "timing"]


@dataclass(frozen=True)
class Channel:
    """One axis of one triad, 'gyro_x'; or its norm, as axis 3."""

    sensor: SensorName
    axis: int

    @property
    def name(self) -> str:
        """'gyro_x'; 'temperature' has one; 'acc_norm' is the fourth."""
        if self.sensor == "temperature":
            return self.sensor
        return f"{self.sensor}_{(*AXES, 'norm')[self.axis]}"
