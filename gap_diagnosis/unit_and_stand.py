# pyright: strict
"""What a recording holds of unit and stand, side by side on the unit's rows; nothing is judged yet."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus
from gap_diagnosis.belief import TRIADS, TriadBelief, triad_belief
from gap_diagnosis.doubtful_samples import set_aside_in
from gap_diagnosis.errors import DiagnosisError, NoReference
from gap_diagnosis.holes import piece_numbers
from gap_diagnosis.lattice import coarse_lattice
from gap_diagnosis.observation import NoiseBelief, Observation, SensorOutput, SetAside, TimingFinding
from gap_diagnosis.prediction import earth_rate_in_body, gravity_in_body, predicted_si
from gap_diagnosis.rest import at_rest, refuse_unless_at_rest
from gap_diagnosis.stand_at_unit import StandReport, stand_at
from gap_diagnosis.temperature import smoothed
from gap_diagnosis.unit_outputs import UnitTriad, unit_supply, unit_temperature_c, unit_triads
from gap_diagnosis.unit_rows import UnitRows, unit_rows
from protocol.errors import Fault
from protocol.recordings import Recording

ROOM_TEMPERATURE_C = 25.0
LEAST_COVERAGE = 0.5
"""A column of the stand that covers less than this share of what its rates cover is left out."""
UNPREDICTED = "the stand tells nothing that predicts it"
ACTING: dict[SensorName, str] = {"gyro": "rate_rad_s", "acc": "specific_force_m_s2", "mag": "field_t"}


@dataclass(frozen=True)
class UnitSide:
    """What a recording holds of the unit, before the stand is looked at."""

    recording: Recording
    rows: UnitRows
    beliefs: Mapping[SensorName, TriadBelief]
    triads: dict[SensorName, UnitTriad]
    unread: tuple[str, ...]
    quanta: Mapping[SensorName, float]
    lattices: tuple[TimingFinding, ...]

    @property
    def mean_over_s(self) -> float:
        """The period that samples are means over; 0 where they are values of an instant."""
        return self.rows.period_s if any(triad.are_means for triad in self.triads.values()) else 0.0


def unit_side(recording: Recording) -> UnitSide:
    """Rows, beliefs and outputs of the unit.

    Raises:
        TestloomError: too few samples, wrong units, a belief that cannot be read.
    """
    rows = unit_rows(recording)
    beliefs: dict[SensorName, TriadBelief] = {sensor: triad_belief(recording, sensor) for sensor in TRIADS}
    triads, unread = unit_triads(recording, beliefs, rows.period_s)
    quanta, lattices = dict[SensorName, float](), list[TimingFinding]()
    for sensor, triad in triads.items():
        believed_si = beliefs[sensor].quantum_si or triad.quantum_si
        quanta[sensor] = believed_si
        if not triad.are_means:
            seen_si, finding = coarse_lattice(sensor, triad.values_si, believed_si)
            quanta[sensor] = max(believed_si, seen_si)
            lattices += [] if finding is None else [finding]
    return UnitSide(recording, rows, beliefs, triads, tuple(unread), quanta, tuple(lattices))


def observed_at(unit: UnitSide, added_s: float) -> Observation:
    """The observation if the stand's clock is ahead of the unit's by `added_s`.

    Raises:
        TestloomError: see `observe`.
    """
    recording, rows = unit.recording, unit.rows
    time_s = rows.time_s + added_s
    site = site_of(recording)
    report, notes = _report(unit, site, time_s)
    usable = np.ones(len(time_s), dtype=bool)
    for values in report.arrays():
        usable &= np.isfinite(values.reshape(len(time_s), -1)).all(axis=1)
    _refuse_without_common_time(recording, time_s, usable)
    piece = piece_numbers(time_s, usable, rows.period_s)
    stimulus, has_temperature = _stimulus(unit, report, site, time_s, added_s)
    outputs, said = _outputs(unit, stimulus, report, piece)
    notes += [*_missing(unit, usable), *said]
    if at_rest(outputs):
        why = "the unit was at rest, so what acts by motion, and the clocks, cannot be told"
        notes.append(SetAside("motion", 0, why))
    if not outputs:
        raise NoReference(
            "Nothing that the unit sends can be predicted from what the stand reports.",
            where=f"recording {recording.recording_id}",
            fault=Fault.DATA,
            remedy="record the stand's rates or specific force, or a unit at rest.",
        )
    return Observation(
        recording_id=recording.recording_id,
        serial=str(recording.unit.get("serial", "")),
        product=str(recording.unit.get("product", "")),
        profile=str(recording.test.get("profile", "")),
        run=str(recording.test.get("run", "")),
        mount=str(recording.test.get("mount", "")),
        stand_id=str(recording.stand.get("id", "")),
        stand_kind=str(recording.stand.get("kind", "")),
        stimulus=stimulus,
        has_temperature=has_temperature,
        outputs=outputs,
        usable=usable,
        piece=piece,
        sample_period_s=rows.period_s,
        aligned_by_s=added_s,
        set_aside=tuple(notes),
        site=site,
        believed=recording.believed,
    )


def _report(
    unit: UnitSide, site: Mapping[str, float], time_s: FloatArray
) -> tuple[StandReport, list[SetAside]]:
    """What the stand says at the rows; of a unit at rest without one, that it did not turn."""
    recording = unit.recording
    if not unit.triads and unit.unread:
        raise NoReference(
            f"Nothing that the unit sends can be read. {' '.join(unit.unread)}",
            where=f"recording {recording.recording_id}, stream dut",
            fault=Fault.DATA,
            remedy="give the column's unit, or believed.counts with per_unit and at_zero.",
        )
    notes = [SetAside(sentence.split(":")[0], len(time_s), sentence) for sentence in unit.unread]
    report = stand_at(recording.streams.get("stand"), time_s, unit.mean_over_s)
    if report.rate_rad_s is None:
        refuse_unless_at_rest(recording, unit.triads, unit.rows.period_s)
        report = dataclasses.replace(report, rate_rad_s=np.zeros((len(time_s), 3)))
    if report.specific_force_m_s2 is None:
        report = dataclasses.replace(report, specific_force_m_s2=gravity_in_body(report, site))
    report, thin = _without_thin_columns(report)
    why = "the stand tells it for less than half of the time"
    return report, [*notes, *(SetAside(name, len(time_s), why) for name in thin)]


def site_of(recording: Recording) -> dict[str, float]:
    """The numbers of `site`.

    Raises:
        DiagnosisError: one of them is no finite number.
    """
    found: dict[str, float] = {}
    for key, value in recording.site.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if not math.isfinite(value):
            raise DiagnosisError(
                f"'{key}' of the site is {value!r}.",
                where=f"recording {recording.recording_id}, site",
                fault=Fault.DATA,
                remedy="correct recording.json.",
            )
        found[key] = float(value)
    return found


def _without_thin_columns(report: StandReport) -> tuple[StandReport, list[str]]:
    """The report without what it tells only now and then, and the names of that."""
    rates = report.rate_rad_s if report.rate_rad_s is not None else np.zeros((1, 3))
    seen = int(np.isfinite(rates).all(axis=1).sum())
    thin = [
        one.name
        for one in dataclasses.fields(report)
        if isinstance(value := getattr(report, one.name), np.ndarray)
        and np.isfinite(value.reshape(len(value), -1)).all(axis=1).sum() < LEAST_COVERAGE * seen  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
    ]
    return dataclasses.replace(report, **dict.fromkeys(thin)), thin  # pyright: ignore[reportArgumentType]


def _stimulus(
    unit: UnitSide, report: StandReport, site: Mapping[str, float], time_s: FloatArray, added_s: float
) -> tuple[Stimulus, bool]:
    recording, rows = unit.recording, unit.rows
    stream = recording.stream("dut")
    earth = earth_rate_in_body(report, site)
    rate = report.rate_rad_s
    if rate is not None and earth is not None and recording.believed.get("earth_rate"):
        rate = rate + earth
    own = unit_temperature_c(stream)
    temperature = smoothed(rows.spread(own), rows.period_s) if own is not None else report.temperature_c
    voltage, current = unit_supply(stream)
    power_on_s = recording.test.get("power_on_s", 0.0)
    stimulus = Stimulus(
        time_s=time_s,
        temperature_c=np.full(len(time_s), ROOM_TEMPERATURE_C) if temperature is None else temperature,
        sample_period_s=rows.period_s,
        rate_rad_s=rate,
        specific_force_m_s2=report.specific_force_m_s2,
        field_t=report.field_t,
        supply_v=report.supply_v if voltage is None else rows.spread(voltage),
        supply_current_a=None if current is None else rows.spread(current),
        angles_rad=report.angles_rad,
        earth_rate_rad_s=earth,
        position_m=report.position_m,
        power_on_s=(float(power_on_s) if isinstance(power_on_s, int | float) else 0.0) + added_s,
    )
    return stimulus, temperature is not None


def _outputs(
    unit: UnitSide, stimulus: Stimulus, report: StandReport, piece: NDArray[np.int64]
) -> tuple[dict[SensorName, SensorOutput], list[SetAside]]:
    """Triads with samples and a prediction; what was set aside in them."""
    outputs, said = dict[SensorName, SensorOutput](), list[SetAside]()
    for sensor, triad in unit.triads.items():
        acting = getattr(stimulus, ACTING[sensor])
        if acting is None:
            said.append(SetAside(sensor, len(stimulus.time_s), UNPREDICTED))
            continue
        belief = unit.beliefs[sensor]
        quantum_si = unit.quanta[sensor]
        predicted = predicted_si(acting, belief, stimulus.sample_period_s, piece)
        values = unit.rows.spread(triad.values_si)
        if not triad.are_means:  # counts of pulses repeat themselves
            values, doubtful = set_aside_in(sensor, values, predicted, belief.range_si, quantum_si)
            said += doubtful
        outputs[sensor] = SensorOutput(
            values_si=values,
            predicted_si=predicted,
            noise=belief.noise,
            quantum_si=quantum_si,
            range_si=belief.range_si,
            bandwidth_hz=belief.bandwidth_hz,
        )
    own = unit_temperature_c(unit.recording.stream("dut"))
    if own is not None and report.temperature_c is not None:
        outputs["temperature"] = _temperature_output(unit.rows.spread(own), report.temperature_c)
    if not set(outputs) - {"temperature"}:
        outputs.clear()
    return outputs, said


def _temperature_output(own_c: FloatArray, chamber_c: FloatArray) -> SensorOutput:
    values, predicted = np.full((len(own_c), 3), np.nan), np.full((len(own_c), 3), np.nan)
    values[:, 0], predicted[:, 0] = own_c, chamber_c
    return SensorOutput(values, predicted, NoiseBelief())


def _missing(unit: UnitSide, usable: NDArray[np.bool_]) -> list[SetAside]:
    """Frames that were lost, values that are missing, rows that the stand does not cover."""
    said: list[SetAside] = []
    if unit.rows.lost:
        said.append(SetAside("frames", unit.rows.lost, "lost between the samples"))
    for sensor, triad in unit.triads.items():
        there = ~np.isnan(triad.values_si).all(axis=0)
        first = 1 if triad.are_means else 0
        count = int(np.count_nonzero(np.isnan(triad.values_si[first:, there]).sum(axis=1)))
        if count:
            said.append(SetAside(sensor, count, "no values (NaN)"))
    if not usable.all():
        said.append(SetAside("rows", int((~usable).sum()), "the stand's report does not cover them"))
    return said


def _refuse_without_common_time(recording: Recording, time_s: FloatArray, usable: NDArray[np.bool_]) -> None:
    if usable.any():
        return
    stand_s = recording.stream("stand").time_s()
    raise DiagnosisError(
        f"Unit and stand have no time in common: {time_s[0]:.3f} to {time_s[-1]:.3f} s and "
        f"{stand_s[0]:.3f} to {stand_s[-1]:.3f} s.",
        where=f"recording {recording.recording_id}, streams dut and stand",
        fault=Fault.DATA,
        remedy="give the stand's report of this run; its clock may have another epoch.",
    )
