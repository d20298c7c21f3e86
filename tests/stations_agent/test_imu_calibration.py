"""The plan `imu_calibration` on the emulated turntable, against the emulator's own truth."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, date, datetime
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.recorded import Source, evaluate
from calibration.records.making import Origin, records_of
from calibration.records.record_parts import CodeVersion, SourceRecording
from dut_emulator.products.gnc_module.population import draw_unit
from dut_emulator.products.gnc_module.unit_truth import Category, TriadTruth, UnitTruth
from dut_emulator.stands.three_axis_turntable import ROOM_TEMPERATURE_C
from protocol.adapters.mcap_form import read_mcap
from protocol.bench_control import Inject
from protocol.bench_description import StandResources
from protocol.errors import Fault, LinkError, RecordingError
from protocol.instruments import StandFacts
from protocol.measurements import Measurement
from protocol.outcomes import Outcome
from protocol.recordings import Recording
from stations.drivers.control_channel import ControlChannel
from stations.drivers.turntable import LineTurntable
from stations.recording_store import keep_recording
from stations.sequencing.runner import SequenceResult
from stations.sequencing.step_registry import bundled_plans

PLAN = bundled_plans()["imu_calibration"]
REFERENCE_TEMPERATURE_C = 25.0
WARM_SHARE = 0.995
"""Of the self-heating, at the middle of the session (time constant 30 s)."""


def serial_with(turntable: Any, wanted: Callable[[UnitTruth], bool]) -> str:
    serials = (f"U-{number:04d}" for number in count(1))
    return next(serial for serial in serials if wanted(draw_unit(turntable.seed, serial)))


def measured(result: SequenceResult) -> dict[str, Measurement]:
    return {m.specification.name: m for step in result.steps for m in step.measurements}


@pytest.fixture(scope="module")
def healthy(turntable: Any) -> tuple[UnitTruth, SequenceResult]:
    serial = serial_with(turntable, lambda unit: unit.category is Category.HEALTHY)
    return draw_unit(turntable.seed, serial), turntable.run(PLAN, serial)


def test_a_healthy_unit_passes_and_is_left_safe(healthy: tuple[UnitTruth, SequenceResult]) -> None:
    _, result = healthy
    assert (result.outcome, result.message) == (Outcome.PASS, "")
    assert result.safe_state
    assert len(measured(result)) == 8 + 2 * 13 + 2 + 8


def _deviations(fitted: TriadCoefficients, truth: TriadTruth, self_heating_c: float) -> np.ndarray:
    """(estimate − truth) / standard uncertainty of scale factors, couplings and biases, shape (12,)."""
    off_diagonal = ~np.eye(3, dtype=bool)
    warm_c = ROOM_TEMPERATURE_C + WARM_SHARE * self_heating_c - REFERENCE_TEMPERATURE_C
    bias = np.array(truth.bias_si) + warm_c * np.array(truth.bias_temperature_si_per_c)
    return np.concatenate(
        [
            (fitted.scale_factor_error() - truth.scale_factor_error)
            / fitted.scale_factor_standard_uncertainty(),
            ((fitted.cross_coupling() - truth.misalignment_rad)[off_diagonal])
            / fitted.cross_coupling_standard_uncertainty()[off_diagonal],
            (fitted.bias - bias) / fitted.bias_standard_uncertainty(),
        ]
    )


def test_the_file_alone_gives_the_same_coefficients_and_they_are_the_truth(
    healthy: tuple[UnitTruth, SequenceResult],
) -> None:
    truth, result = healthy
    reference = result.recordings[0]
    path = Path(reference.path)
    assert hashlib.sha256(path.read_bytes()).hexdigest() == reference.sha256 == path.stem
    recording = read_mcap(path)
    evaluation = evaluate([Source(recording)])
    assert evaluation.gyro is not None
    assert evaluation.acc is not None
    values = measured(result)
    for triad, fitted in (("gyro", evaluation.gyro), ("acc", evaluation.acc)):
        for index, axis in enumerate("xyz"):
            in_percent = values[f"{triad}_scale_factor_error_{axis}"].value
            assert in_percent == pytest.approx(100 * fitted.scale_factor_error()[index], rel=1e-12)
    deviations = np.concatenate(
        [
            _deviations(evaluation.gyro, truth.gyro, truth.self_heating_c),
            _deviations(evaluation.acc, truth.acc, truth.self_heating_c),
        ]
    )
    assert np.abs(deviations).max() < 3.0
    assert 0.3 < np.sqrt((deviations**2).mean()) < 1.5
    # the unit's crystal, seen through the turns
    skew = recording.test["time_alignment"]["skew"]
    assert skew == pytest.approx(-truth.crystal_error, abs=1e-6)


def test_a_record_of_it_names_the_stand_and_says_that_it_was_emulated(
    turntable: Any, healthy: tuple[UnitTruth, SequenceResult]
) -> None:
    """No certificate of an emulated unit may be taken for a real one's."""
    recording = read_mcap(Path(healthy[1].recordings[0].path))
    origin = Origin(
        (SourceRecording(recording_id="r-1", sha256="a" * 64, form="mcap"),),
        CodeVersion(package="testloom 0"),
        datetime(2026, 1, 1, tzinfo=UTC),
    )
    records = records_of(evaluate([Source(recording)]), [recording], origin)
    for record in records:
        stand = record.stand
        assert stand is not None
        assert (stand.id, stand.kind) == (turntable.description.stand.stand_id, "three_axis_turntable")
        assert stand.calibration_due == date.fromisoformat(recording.stand["calibration_due"])
        assert stand.emulated
    assert recording.stand["identification"].startswith("Testloom,TT3,")


def test_a_stand_of_hardware_is_not_called_emulated() -> None:
    answers = {"*IDN?": "Acutronic,AC3350,17,4.2", "CAL?": "2027-03-01"}
    stand = StandResources(stand_id="tt-9", kind="three_axis_turntable", command="127.0.0.1:1")
    session = SimpleNamespace(stand=stand, emulated=False, ask=answers.__getitem__, where="stand tt-9")
    facts = LineTurntable(session, None, None).facts()  # type: ignore[arg-type]
    assert facts == StandFacts(
        "tt-9", "three_axis_turntable", "Acutronic,AC3350,17,4.2", "2027-03-01", emulated=False
    )
    answers["CAL?"] = "soon"
    with pytest.raises(LinkError, match="'soon'"):
        LineTurntable(session, None, None).facts()  # type: ignore[arg-type]


def test_the_plan_states_uncertainties_that_its_own_session_keeps(
    healthy: tuple[UnitTruth, SequenceResult],
) -> None:
    _, result = healthy
    evaluation = evaluate([Source(read_mcap(Path(result.recordings[0].path)))])
    stated = {name: (m.specification.standard_uncertainty or 0.0) for name, m in measured(result).items()}
    for triad, fitted, bias_unit in (
        ("gyro", evaluation.gyro, np.pi / 180),
        ("acc", evaluation.acc, 9.80665e-3),
    ):
        assert fitted is not None
        assert (
            fitted.scale_factor_standard_uncertainty().max() < stated[f"{triad}_scale_factor_error_x"] / 100
        )
        assert fitted.cross_coupling_standard_uncertainty().max() < stated[f"{triad}_coupling_xy"]
        assert fitted.bias_standard_uncertainty().max() < stated[f"{triad}_bias_x"] * bias_unit


@pytest.mark.parametrize(
    ("defect", "category", "step", "names"),
    [
        ("gyro_scale", Category.MARGINAL, "imu_coefficients", "gyro_scale_factor_error_"),
        ("acc_bias", Category.GROSS, "imu_coefficients", "acc_bias_"),
        ("dead_gyro_axis", Category.GROSS, "imu_response", "gyro_response_"),
    ],
)
def test_a_defective_unit_fails_by_its_own_fault_and_is_not_written_to(
    turntable: Any, defect: str, category: Category, step: str, names: str
) -> None:
    def wanted(unit: UnitTruth) -> bool:
        saturates = max(unit.gyro.scale_factor_error) > 0.03
        return unit.defect == defect and unit.category is category and not saturates

    result = turntable.run(PLAN, serial_with(turntable, wanted))
    assert (result.outcome, result.fault) == (Outcome.FAIL, Fault.UNIT)
    assert result.message.startswith(f"{step}: {names}")
    assert "imu_write_coefficients" not in {ran.step for ran in result.steps}
    assert result.safe_state
    assert result.recordings  # what was seen can be looked at


def test_a_saturated_gyro_is_seen_as_such(turntable: Any) -> None:
    serial = serial_with(turntable, lambda unit: max(unit.gyro.scale_factor_error) > 0.1)
    result = turntable.run(PLAN, serial)
    assert (result.outcome, result.fault) == (Outcome.FAIL, Fault.UNIT)
    assert "gyro_saturated_samples" in result.message


@contextmanager
def injected(turntable: Any, target: str, fault: Literal["door_open", "drop"]) -> Iterator[None]:
    channel = ControlChannel(turntable.description.control, "saboteur", observer=True)
    try:
        channel.request(Inject(target=target, fault=fault))
        yield
    finally:
        channel.request(Inject(target=target, fault="none"))
        channel.close()


@pytest.mark.parametrize(
    ("target", "sabotage", "fault", "words"),
    [
        ("stand", "door_open", Fault.STAND, "refuses"),
        ("1.rs422", "drop", Fault.FIXTURE, "samples were lost"),
    ],
)
def test_what_is_not_the_unit_s_fault_is_not_put_on_it(
    turntable: Any, target: str, sabotage: Literal["door_open", "drop"], fault: Fault, words: str
) -> None:
    serial = serial_with(turntable, lambda unit: unit.category is Category.HEALTHY)
    with injected(turntable, target, sabotage):
        result = turntable.run(PLAN, serial)
    assert (result.outcome, result.fault) == (Outcome.ERROR, fault), result.message
    assert words in result.message


def test_a_recording_that_cannot_be_kept_is_the_station_s_fault(tmp_path: Path) -> None:
    (tmp_path / "full").write_text("no folder")
    with pytest.raises(RecordingError) as caught:
        keep_recording(Recording("r-1", {}, {}, {}), tmp_path / "full", "")
    assert caught.value.fault is Fault.STATION
