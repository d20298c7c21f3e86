"""Certificates and original records: what is on them, in both languages, and the same bytes every time."""

import contextlib
import json
import re
import zlib
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from calibration.certificate import printing
from calibration.certificate.composing import certificate, document_json, original_record, qr_payload
from calibration.certificate.conformity import judge
from calibration.certificate.details import CertificateDetails, Party, Tolerance, parse_details
from calibration.certificate.document import Correlations, Document, Grid, Paragraph
from calibration.certificate.printing import printed, qr_svg
from calibration.certificate.units_on_paper import shown_unit
from calibration.certificate.wording import unit_words
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity, Interval
from protocol.errors import CalibrationError, Fault
from tests.calibration.certificate_samples import (
    CHINESE_DETAILS,
    DETAILS,
    SAMPLES,
    fog,
    gnc_module,
    rate_gyro_triad,
)

COMPOSED = {"certificate": certificate, "original_record": original_record}
NOTHING = CertificateDetails()
CHINESE = re.compile("[\u4e00-\u9fff]")


def grids(document: Document) -> list[Grid]:
    return [block for section in document.sections for block in section.blocks if isinstance(block, Grid)]


def cells(document: Document) -> set[str]:
    return {cell for grid in grids(document) for row in grid.rows for cell in row}


def streams(pdf: bytes) -> list[bytes]:
    """What a PDF's compressed streams hold."""
    found: list[bytes] = []
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL):
        with contextlib.suppress(zlib.error):
            found.append(zlib.decompress(stream))
    return found


def warnings_of(document: Document) -> list[str]:
    blocks = [block for section in document.sections for block in section.blocks]
    return [block.text for block in blocks if isinstance(block, Paragraph) and block.tone == "warning"]


def details_for(record: CalibrationRecord, language: str) -> CertificateDetails:
    details = DETAILS if language == "en" else CHINESE_DETAILS
    return details if record.product == "rate_gyro_triad" else details.model_copy(update={"tolerances": {}})


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("product", SAMPLES)
def test_pages_of_every_product_can_be_set_and_carry_the_record(product: str, language: str) -> None:
    record = SAMPLES[product]()
    for compose in COMPOSED.values():
        pdf = printed(compose(record, details_for(record, language), language), record.canonical_json())
        assert pdf.startswith(b"%PDF-1.7")
        assert record.canonical_json().encode() in streams(pdf)
        assert b"/CreationDate(D:20260305" in pdf  # the record's day, not the clock's


@pytest.mark.parametrize("language", ["en", "zh"])
def test_equal_input_gives_equal_bytes(language: str) -> None:
    first, again = (
        printed(
            certificate(rate_gyro_triad(), details_for(rate_gyro_triad(), language), language),
            rate_gyro_triad().canonical_json(),
        )
        for _ in range(2)
    )
    assert first == again


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("kind", COMPOSED)
@pytest.mark.parametrize("product", SAMPLES)
def test_a_document_holds_every_quantity_recording_and_origin(product: str, kind: str, language: str) -> None:
    record = SAMPLES[product]()
    document = COMPOSED[kind](record, NOTHING, language)
    found = cells(document)
    assert {f"${quantity.symbol}" for quantity in record.quantities} <= found
    assert {one.sha256 for one in record.recordings} <= found
    content = json.loads(document_json(document, record, NOTHING))
    assert content["record"]["quantities"] == json.loads(record.canonical_json())["quantities"]
    assert content["record_sha256"] == record.sha256()
    everything = json.dumps(content["document"], ensure_ascii=False)
    assert record.stand is not None
    for words in (record.serial, record.stand.id, str(record.stand.calibration_due), record.code.package):
        assert words in everything
    headings = [section.title for section in document.sections] + [document.title, document.footer]
    if language == "zh":
        assert all(CHINESE.search(heading) for heading in headings if heading)
    else:
        assert not CHINESE.search(everything)


def test_results_are_written_as_far_as_they_are_known() -> None:
    found = {
        row[1]: row for grid in grids(certificate(rate_gyro_triad(), NOTHING, "en")) for row in grid.rows
    }
    # u = 4.2e-6 V/(deg/s), k = 2.32: U = 9.744e-6
    assert found["$K"][2:6] == ("0.0506980", "0.0000097", "V/(°/s)", "2.32")
    found = {row[1]: row for grid in grids(certificate(gnc_module(), NOTHING, "en")) for row in grid.rows}
    assert found["$b_x"][2] == "0.0138"  # 2.41e-4 rad/s = 0.013808 deg/s
    assert found["$b_x"][4] == "°/s"
    found = {row[1]: row for grid in grids(certificate(fog(), NOTHING, "en")) for row in grid.rows}
    assert found["$τ"][2:6] == ("242.23", "", "[239.27, 245.19]", "µs")
    assert found["$T_f"][2:5] == ("500.0000", "0.0024", "")
    (results,) = [grid for grid in grids(certificate(fog(), NOTHING, "en")) if "Symbol" in grid.headings]
    assert results.headings[4] == "Interval, p = 99 %"


def test_the_original_record_gives_the_readings_as_they_were_read() -> None:
    record = rate_gyro_triad()
    table = next(grid for grid in grids(original_record(record, NOTHING, "en")) if "Readings" in grid.title)
    assert table.headings[:3] == ("Rate, °/s", "Up 1, V", "Down 1, V")
    up = next(column for column in record.tables[0].columns if column.name == "up_1")
    assert [row[1] for row in table.rows] == [f"{value:.4f}".replace("-", "−") for value in up.values]
    assert not any("Readings" in grid.title for grid in grids(certificate(record, NOTHING, "en")))
    pictures = certificate(record, NOTHING, "en").pictures
    assert set(pictures) == {"table-1-1.svg", "table-1-2.svg"}
    assert ">Residual, 10⁻⁴ V<" in pictures["table-1-2.svg"]


def test_a_budget_adds_up_and_dependent_results_show_their_correlation() -> None:
    document = certificate(rate_gyro_triad(), NOTHING, "en")
    budget = next(grid for grid in grids(document) if grid.headings[0] == "Contribution")
    parts = [float(row[-1].removeprefix("part|")) for row in budget.rows[:-1]]
    assert sum(parts) == pytest.approx(100.0, abs=0.2)
    assert parts[0] == pytest.approx(71.6, abs=0.1)  # (6.1e-4 * 0.0815)^2 of the sum, by hand
    triangle = [
        block
        for section in certificate(SAMPLES["pulse_imu"](), NOTHING, "en").sections
        for block in section.blocks
        if isinstance(block, Correlations)
    ]
    assert triangle[0].rows[1] == ("-0.72", "1.00")


def test_an_overdue_stand_or_instrument_is_said_in_a_frame() -> None:
    assert warnings_of(certificate(fog(), NOTHING, "en")) == [
        "The calibration of the stand was overdue at the time of the measurement."
    ]
    assert not warnings_of(certificate(gnc_module(), DETAILS.model_copy(update={"tolerances": {}}), "en"))
    late = DETAILS.standards[0].model_copy(update={"calibration_due": date(2026, 3, 4)})
    details = DETAILS.model_copy(update={"tolerances": {}, "standards": (late,)})
    assert "Digital multimeter" in warnings_of(original_record(gnc_module(), details, "en"))[0]


def test_nobody_takes_an_emulated_units_certificate_for_a_real_one() -> None:
    record = fog()
    stand = record.stand.model_copy(update={"emulated": True, "calibration_overdue": False})
    for document in (certificate, original_record):
        made = document(record.model_copy(update={"stand": stand}), NOTHING, "en")
        (warning,) = warnings_of(made)
        assert made.sections[0].blocks == (Paragraph(warning, "warning"),)  # below the title, on page 1
        assert "emulated" in warning


def _quantity(value: float, u: float | None, interval: Interval | None = None) -> CalibratedQuantity:
    return CalibratedQuantity(
        name="bias_x", value=value, unit="mg", standard_uncertainty=u, interval=interval
    )


@pytest.mark.parametrize(
    ("value", "u", "verdict"),
    [
        (7.9, 1.0, "conforms"),  # 9.9 <= 10
        (8.1, 1.0, "open"),
        (11.9, 1.0, "open"),
        (12.1, 1.0, "does_not_conform"),
        (0.0, 1.6, "conforms"),  # U = 3.2 <= 10/3
        (0.0, 1.7, "not_good_enough"),
        (-8.1, 1.0, "open"),
    ],
)
def test_the_decision_rule_keeps_u_from_the_limits(value: float, u: float, verdict: str) -> None:
    limits = Tolerance(unit="g", lower=-0.010, upper=0.010)
    assert judge(_quantity(value, u), limits).verdict == verdict
    within = Interval(lower=value - 2 * u, upper=value + 2 * u, probability=0.95)
    assert judge(_quantity(value, None, within), limits).verdict == verdict


def test_a_tolerance_that_does_not_fit_the_record_is_refused() -> None:
    wrong_unit = CertificateDetails(tolerances={"bias_x": Tolerance(unit="V", upper=1.0)})
    with pytest.raises(CalibrationError, match="do not measure the same"):
        certificate(gnc_module(), wrong_unit, "en")
    of_nothing = CertificateDetails(tolerances={"linearity_x": Tolerance(unit="%", upper=1.0)})
    with pytest.raises(CalibrationError, match="which the record does not have"):
        certificate(gnc_module(), of_nothing, "en")


def test_conformity_is_printed_in_the_customers_unit() -> None:
    document = certificate(rate_gyro_triad(), DETAILS, "en")
    row = next(row for grid in grids(document) for row in grid.rows if row[-1].startswith("good|"))
    assert row[:4] == ("Linearity x", "≤ 0.2", "%", "0.07")  # U = 2.32 * 5.88e-5 = 0.0136 %
    assert ("0.078", "0.014", "%") in {row[2:5] for grid in grids(document) for row in grid.rows}
    assert any(
        "U ≤ T/3" in json.dumps(section.blocks[-1].__dict__, ensure_ascii=False)
        for section in document.sections
        if section.title == "Conformity"
    )


def test_the_qr_code_says_which_record_it_is() -> None:
    record = gnc_module()
    assert qr_payload(record) == f"testloom:calibration-record:sha256:{record.sha256()}"
    assert certificate(record, NOTHING, "zh").qr_payload == qr_payload(record)
    other = record.model_copy(update={"serial": "GM-7-0004"})
    assert qr_svg(qr_payload(other)) != qr_svg(qr_payload(record))


def test_without_a_font_for_chinese_it_says_what_to_install() -> None:
    record = gnc_module()
    document = certificate(record, NOTHING, "zh")
    with pytest.raises(CalibrationError) as raised:
        printed(document, record.canonical_json(), installed=("Liberation Serif",))
    assert raised.value.fault is Fault.OPERATOR
    assert "fonts-wqy-microhei" in raised.value.remedy


def test_a_letter_that_no_font_has_is_refused_and_not_printed_as_a_box() -> None:
    record = gnc_module()
    details = CertificateDetails(customer=Party(name="ⵣ"))
    with pytest.raises(CalibrationError, match="No font has the letters 'ⵣ'") as raised:
        printed(certificate(record, details, "en"), record.canonical_json())
    assert raised.value.fault is Fault.OPERATOR


def test_english_needs_no_font_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[set[str]] = []
    compile_ = printing.typst.compile

    def spy(files: object, **options: Any) -> bytes:
        given.append(set(options["font_paths"].families()))
        return compile_(files, **options)  # type: ignore[call-overload,no-any-return]

    monkeypatch.setattr(printing.typst, "compile", spy)
    record = rate_gyro_triad()
    printed(certificate(record, DETAILS, "en"), record.canonical_json())
    assert {printing.LATIN_FAMILY, printing.SYMBOL_FAMILY} <= given[0]
    assert given[0] == set(printing.typst.Fonts(include_system_fonts=False).families())


def test_a_customers_name_is_text_and_never_markup() -> None:
    record = gnc_module()
    details = CertificateDetails(customer=Party(name='#panic("x") *a* $b_c$ \\ "q" <l> @r //'))
    assert printed(certificate(record, details, "en"), record.canonical_json()).startswith(b"%PDF")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("number: [", "YAML"),
        ("- 1", "the top"),
        ("costumer: {name: x}", "costumer"),
        ("issued: 5.3.2026", "issued"),
        ("number: 17", "number"),
        ("tolerances: {bias_x: {unit: mg}}", "neither a lower nor an upper"),
        ("tolerances: {bias_x: {unit: mg, lower: 2, upper: 1}}", "no room"),
        ("tolerances: {bias_x: {unit: furlong, upper: 1}}", "furlong"),
        ("number: a\nnumber: b", "twice"),
    ],
)
def test_details_that_are_wrong_are_refused_by_name(text: str, place: str) -> None:
    with pytest.raises(CalibrationError, match=place) as raised:
        parse_details(text, "details.yaml")
    assert raised.value.where == "details.yaml"


def test_a_method_that_is_not_known_here_is_named_and_nothing_is_claimed() -> None:
    record = CalibrationRecord.model_validate(
        {**gnc_module().model_dump(), "method": "dividing_head", "tables": (), "stand": None}
    )
    text = json.dumps(certificate(record, NOTHING, "en").as_json(), ensure_ascii=False)
    assert "Dividing head" in text
    assert "no description of this method is held here" in text
    assert "The recordings name no stand" in text


@pytest.mark.parametrize(
    ("unit", "written"),
    [("V/(deg/s)", "V/(°/s)"), ("ug/sqrt(Hz)", "µg/√Hz"), ("degC", "°C"), ("m/s^2", "m/s²"), ("uT", "µT")],
)
def test_units_are_written_as_people_write_them(unit: str, written: str) -> None:
    assert unit_words(unit) == written


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("rad/s", "deg/s"), ("V/(rad/s)", "V/(deg/s)"), ("m/s^2", "m/s^2"), ("1", "1"), ("g", "g")],
)
def test_angles_are_shown_in_degrees(unit: str, shown: str) -> None:
    assert shown_unit(unit) == shown


def test_the_documented_details_are_details() -> None:
    page = (Path(__file__).parents[2] / "docs" / "certificates.md").read_text(encoding="utf-8")
    found = parse_details(page.split("```yaml\n")[1].split("```")[0], "docs/certificates.md")
    assert set(found.tolerances) == {"scale_factor_nonlinearity", "bias"}
    assert found.standards[0].calibration_due == date(2026, 8, 14)
