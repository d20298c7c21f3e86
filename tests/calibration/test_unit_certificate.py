"""Certificates of whole units, and the field's units on paper."""

import hashlib
import json
import re
from datetime import date

import pytest

from calibration.certificate.composing import certificate
from calibration.certificate.conformity import judgements_together
from calibration.certificate.details import CertificateDetails, Tolerance
from calibration.certificate.document import Grid
from calibration.certificate.printing import printed
from calibration.certificate.unit_certificate import (
    in_order,
    unit_certificate,
    unit_document_json,
    unit_original_record,
)
from calibration.certificate.units_on_paper import Size, shown_unit
from calibration.certificate.wording import equation_words, sentence_words, unit_words
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity
from protocol.errors import CalibrationError
from tests.calibration.certificate_samples import fog, gnc_module, pulse_imu, rate_gyro_triad
from tests.calibration.test_certificate import NOTHING, cells, grids, streams


def results_of(record: CalibrationRecord) -> Grid:
    found = grids(certificate(record, NOTHING, "en"))
    return next(grid for grid in found if "Value" in grid.headings)


def _number(text: str) -> float:
    """'−1.5 × 10⁻⁶' → -1.5e-6."""
    digits, _, power = text.translate(str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789")).partition(" × 10")
    return float(f"{digits}e{power or 0}")


@pytest.mark.parametrize(
    ("unit", "size", "name", "shown"),
    [
        ("rad/s", Size(5e-7), "bias", "deg/h"),  # 0.1 deg/h
        ("rad/s", Size(2e-3), "bias", "deg/s"),
        ("m/s^2", Size(2e-3), "bias", "ug"),
        ("m/s^2", Size(0.05), "bias", "mg"),
        ("m/s^2", Size(9.8), "specific_force", "m/s^2"),
        ("m/s^2/(degC)", Size(1e-3), "bias_temperature_sensitivity", "ug/(degC)"),
        ("rad/s/(m/s^2)", Size(1e-3), "g_sensitivity", "deg/s/(g)"),
        ("1/(m/s^2)", Size(3e-6), "quadratic_nonlinearity", "ppm/(g)"),
        ("1", Size(3e-4), "scale_factor_nonlinearity", "ppm"),
        ("1", Size(0.02), "hysteresis", "%"),
        ("1", Size(1.002), "scale_factor", "1"),
        ("s", Size(2.4e-4, 2e-5), "pure_lag", "us"),
        ("s", Size(3.8e-4, 1.9e-4), "lag", "ms"),  # 190 us would need a power of ten
    ],
)
def test_results_are_in_the_fields_units(unit: str, size: Size, name: str, shown: str) -> None:
    assert shown_unit(unit, size, name) == shown


def test_units_equations_and_numbers_are_written_as_people_write_them() -> None:
    assert unit_words("ppm/(g)") == "µg/g²"  # 1e-6 / g is 1e-6 g / g^2
    assert equation_words("y = M u + b; u = inv(M) (y - b)", str) == "eq|y = M u + b; u = M⁻¹ (y − b)"
    assert equation_words("Y = bias + scale_factor R", str) == "eq|Y = bias + scale factor R"
    assert sentence_words("bias 2.7e-05 with 1e+06 s") == "bias 2.7 × 10⁻⁵ with 1 × 10⁶ s"


def test_axes_share_a_unit_and_a_budget_adds_up_in_it() -> None:
    results = results_of(gnc_module())
    unit = results.headings.index("Unit of measure")
    assert {row[unit] for row in results.rows if row[0].startswith("Bias")} == {"°/s"}
    record = rate_gyro_triad()
    budget = next(one for one in grids(certificate(record, NOTHING, "en")) if "Contribution" in one.headings)
    printed_in = budget.headings[6].removeprefix("|c u|, ")
    in_unit = record.budgets[0].standard_uncertainty * {"ppm": 1e6, "%": 1e2}[printed_in]
    assert float(budget.rows[-1][6]) == pytest.approx(in_unit, rel=5e-3)
    for row in budget.rows[:-1]:
        u, c, product = (_number(row[k]) for k in (3, 5, 6))
        assert abs(u * c) == pytest.approx(product, rel=1e-2)


def test_it_is_not_issued_before_it_was_evaluated() -> None:
    with pytest.raises(CalibrationError, match="2026-03-05, which is later"):
        certificate(gnc_module(), CertificateDetails(issued=date(2026, 3, 3)), "en")


def of_one_unit() -> list[CalibrationRecord]:
    unit = {"serial": "GM-7-0003", "product": "gnc_module"}
    return [gnc_module(), fog().model_copy(update=unit), pulse_imu().model_copy(update=unit)]


def test_records_of_a_unit_make_one_certificate_that_carries_them_all() -> None:
    records = in_order(of_one_unit())
    assert records == in_order(of_one_unit()[::-1])  # whatever order they are named in
    document = unit_certificate(records, NOTHING, "en")
    attached = {one.file_name: one.canonical_json() for one in records}
    pdf = printed(document, attached)
    assert {text.encode() for text in attached.values()} <= set(streams(pdf))
    assert all(name.encode() in pdf for name in attached)
    # The identity by hand: what sha256sum prints for the files, sorted by name.
    listing = "".join(
        f"{hashlib.sha256(text.encode()).hexdigest()}  {name}\n" for name, text in sorted(attached.items())
    )
    assert document.identity == hashlib.sha256(listing.encode()).hexdigest()
    assert document.qr_payload == f"testloom:calibration-records:sha256:{document.identity}"


@pytest.mark.parametrize("language", ["en", "zh"])
def test_every_part_holds_what_its_record_holds(language: str) -> None:
    records = in_order(of_one_unit())
    for compose in (unit_certificate, unit_original_record):
        document = compose(records, NOTHING, language)
        found = cells(document)
        for record in records:
            assert {f"${quantity.symbol}" for quantity in record.quantities} <= found
            assert {one.sha256 for one in record.recordings} <= found
        assert len([one.title for one in document.sections if re.match(r"\d  ", one.title)]) == 3
    content = json.loads(unit_document_json(document, records, NOTHING))
    assert [one["sensor"] for one in content["records"]] == [one.sensor for one in records]
    assert content["records_sha256"] == document.identity


def test_records_of_other_units_are_refused() -> None:
    with pytest.raises(CalibrationError, match="of 2 units: gnc_module GM-7-0003, fog FOG-3-0001"):
        in_order([gnc_module(), fog()])


def test_a_tolerance_is_of_the_sensor_whose_unit_it_has() -> None:
    bias = CalibratedQuantity(name="bias_x", value=0.0, unit="m/s^2", standard_uncertainty=0.01)
    acc = {"sensor": "acc", "covariance": (), "tables": (), "quantities": (bias,)}
    records = in_order([gnc_module(), gnc_module().model_copy(update=acc)])
    limits = {"bias_x": Tolerance(unit="mg", lower=-50, upper=50)}
    judged = judgements_together(records, CertificateDetails(tolerances=limits))
    assert [(one.sensor, len(found)) for one, found in zip(records, judged, strict=True)] == [
        ("acc", 1),
        ("gyro", 0),
    ]
    limits = {"bias_x": Tolerance(unit="V", upper=1.0)}
    with pytest.raises(CalibrationError, match="bias_x in V, which none"):
        unit_certificate(records, CertificateDetails(tolerances=limits), "en")
