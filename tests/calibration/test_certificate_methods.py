"""Certificates of what each method finds: every name on the page is in the page's language."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.magnetometer import hard_and_soft_iron
from calibration.algorithms.overload_g_sensitivity import GSensitivity
from calibration.algorithms.pure_lag import PureLag
from calibration.algorithms.rate_gyro import evaluate_rate_gyro
from calibration.algorithms.repeatability import repeatability
from calibration.algorithms.sinusoidal_overload import KnownAccelerometer, calibrate_overload
from calibration.algorithms.temperature_compensation import fit_temperature
from calibration.certificate.composing import certificate, original_record
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Document, Grid, speaker
from calibration.certificate.figures import table_figures
from calibration.certificate.methods import method_words
from calibration.certificate.printing import printed
from calibration.certificate.result_tables import results_grid
from calibration.certificate.wording import unit_words
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.records.inertial_contents import repeatability_content
from calibration.records.making import Origin, RecordContent, record_of
from calibration.records.method_contents import (
    allan_content,
    g_sensitivity_content,
    magnetometer_content,
    overload_content,
    pure_lag_content,
    rate_gyro_content,
)
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CodeVersion, SourceRecording
from calibration.records.temperature_contents import temperature_content
from protocol.recordings import Recording
from protocol.units_of_measure import KNOWN_UNITS
from tests.calibration.test_magnetometer import _turned
from tests.calibration.test_rate_gyro import METER, PAPER_RUNS, TABLE
from tests.calibration.test_sinusoidal_overload import KNOWN, pulses_of, sinusoid
from tests.calibration.test_temperature_compensation import NODES, POSES, ROOM, ROOM_C, run
from tests.calibration.test_temperature_warm_up import recording

STAND = {"id": "s-1", "kind": "three_axis_turntable", "calibration_due": "2026-12-31"}
NO_WORDS = re.compile(r"^(?:\$.*|part\|.*|[0-9a-f]{64}|.*[\u4e00-\u9fff].*|[^A-Za-z]*|\|c u\||r-1|s-1|mcap)$")
UNITS = {unit_words(unit) for unit in KNOWN_UNITS}


def _rate_gyro() -> RecordContent:
    return rate_gyro_content(PAPER_RUNS, evaluate_rate_gyro(PAPER_RUNS), TABLE, METER)


def _pure_lag() -> RecordContent:
    return pure_lag_content(PureLag(245.19e-6, 239.27e-6, 242.23e-6, 2.96e-6, 2.96e-6 / 3**0.5, 31))


def _overload() -> RecordContent:
    motion = sinusoid(10.0, cycles=6)
    known = KnownAccelerometer(KNOWN.scale_factor_pulse_s_m, KNOWN.bias_m_s2, 1e-4, 1e-2, 1e-5)
    return overload_content(calibrate_overload(motion, pulses_of(motion), known))


def _g_sensitivity() -> RecordContent:
    matrix = np.arange(9.0).reshape(3, 3) * 1e-7
    of_rows = np.array([np.diag([1.0, 4.0, 9.0])] * 3) * 1e-16
    return g_sensitivity_content(GSensitivity(matrix, of_rows, np.zeros((1, 3)), matrix))


def _allan() -> RecordContent:
    white = 2e-3 * np.random.default_rng(4).standard_normal(20_000)
    return allan_content(fit_allan_coefficients(overlapping_allan_deviation(white, 100.0)), "rad/s")


def _magnetometer() -> RecordContent:
    return magnetometer_content(hard_and_soft_iron(_turned(400, 0.02, 1)), "uT", "1")


def _temperature() -> RecordContent:
    return temperature_content(fit_temperature(run(POSES, NODES), ROOM, ROOM_C))


def _thermal_network() -> RecordContent:
    (result,) = evaluate_by_profile([recording()]).results
    return result.content


def _repeatability() -> RecordContent:
    values, u = np.random.default_rng(1).normal(size=(6, 3)) * 1e-3, np.full((6, 3), 1e-4)
    found = repeatability(values, u, "each_power_on")
    return repeatability_content("bias", "xyz", found, list("123456"), (values, u), "m/s^2")


FOUND = {
    "rate_gyro": (_rate_gyro, "gyro"),
    "pure_lag": (_pure_lag, "gyro"),
    "sinusoidal_overload": (_overload, "acc_x"),
    "g_sensitivity": (_g_sensitivity, "gyro"),
    "allan_variance": (_allan, "gyro"),
    "magnetometer": (_magnetometer, "mag"),
    "temperature_compensation": (_temperature, "acc"),
    "thermal_network": (_thermal_network, "thermal"),
    "repeatability": (_repeatability, "acc"),
}


def recorded(name: str) -> CalibrationRecord:
    content, sensor = FOUND[name]
    origin = Origin(
        (SourceRecording(recording_id="r-1", sha256="a" * 64, form="mcap"),),
        CodeVersion(package="testloom 0"),
        datetime(2026, 1, 1, tzinfo=UTC),
    )
    recording = Recording("r-1", {"serial": "U-1", "product": "any"}, {"profile": "any"}, {}, stand=STAND)
    return record_of(content(), sensor, [recording], origin)


def texts(document: Document) -> list[str]:
    """Headings, titles and cells."""
    found: list[str] = []
    for section in document.sections:
        for block in section.blocks:
            if isinstance(block, Grid):
                found += [block.title, block.note, *(cell for row in block.rows for cell in row)]
                found += [re.sub(r", ?(10\S+ ?)?\S*$", "", heading) for heading in block.headings]
    return found


def is_english(text: str) -> bool:
    """Beside symbols, units, numbers and identities."""
    number = re.search(r"p = | × 10", text)
    unit = text in UNITS or set(text) & set("/°√²")
    return not (NO_WORDS.match(text) or number or unit)


@pytest.mark.parametrize("name", FOUND)
def test_every_name_on_a_chinese_page_is_chinese(name: str) -> None:
    record = recorded(name)
    for compose in (certificate, original_record):
        document = compose(record, CertificateDetails(), "zh")
        english = [text for text in texts(document) if is_english(text)]
        assert english == []


@pytest.mark.parametrize("name", ["temperature_compensation", "rate_gyro"])
def test_the_widest_records_can_be_set(name: str) -> None:
    record = recorded(name)
    for compose in (certificate, original_record):
        for language in ("en", "zh"):
            assert printed(compose(record, CertificateDetails(), language), record.canonical_json())


def test_a_value_by_definition_has_no_uncertainty_and_a_warm_up_no_decades() -> None:
    """What is zero by the frame of reference is exact; a settling curve is read on straight axes."""
    record = recorded("thermal_network")
    first, *others = record.quantities
    fixed = first.model_copy(update={"value": 0.0, "standard_uncertainty": 0.0, "degrees_of_freedom": None})
    exact = record.model_copy(update={"quantities": (fixed, *others), "covariance": ()})
    grid = results_grid(exact, CertificateDetails(), speaker("en"))
    assert grid.rows[0][2:4] == ("0", "exact")
    assert "Exact: by definition" in grid.note
    (table,) = [one for one in record.tables if one.name == "warm_up"]
    ((drawn, _),) = table_figures(table, speaker("en"))
    assert "Rise, °C" in drawn
    assert "10⁻²" not in drawn


@pytest.mark.parametrize("language", ["en", "zh"])
def test_every_method_has_words(language: str) -> None:
    say = speaker(language)
    unknown = method_words("no_such", "none", say).source
    for name in FOUND:
        record = recorded(name)
        words = method_words(record.method, record.model.name, say)
        assert words.title
        assert words.source != unknown
    assert method_words("magnetometer", "spin", say) != method_words("magnetometer", "ellipsoid", say)


def test_the_original_record_of_a_rate_gyro_has_every_stroke() -> None:
    document = original_record(recorded("rate_gyro"), CertificateDetails(), "en")
    grids = [block for section in document.sections for block in section.blocks if isinstance(block, Grid)]
    (readings,) = [grid for grid in grids if grid.title == "Readings"]
    strokes = len(PAPER_RUNS.up_v)
    assert len(readings.rows) == 11
    assert [heading for heading in readings.headings if re.match("(Up|Down) ", heading)] == [
        f"{way} {cycle}, V" for cycle in range(1, strokes + 1) for way in ("Up", "Down")
    ]
    column = readings.headings.index("Down 2, V")
    written = [float(row[column].replace("−", "-")) for row in readings.rows]
    np.testing.assert_allclose(written, PAPER_RUNS.down_v[1], atol=1e-6)
