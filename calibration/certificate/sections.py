# pyright: strict
"""Sections that a certificate and an original record share: what, for whom, where, with what, from what."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import date, datetime

from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Block, Facts, Grid, Paragraph, Say, Section, facts
from calibration.certificate.methods import method_words
from calibration.certificate.result_tables import without_empty_columns
from calibration.certificate.rounding import plain
from calibration.certificate.wording import capital, equation_words, quantity_words, sentence_words
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import TemperatureSpan
from protocol.language import translated

PRODUCTS = {
    "gnc_module": "GNC module",
    "mems_ahrs": "MEMS attitude and heading reference",
    "fog": "Fibre-optic gyro",
    "rate_gyro_triad": "Rate gyro triad",
    "pulse_imu": "IMU with pulse outputs",
}
"""Names of products for people; another product's name is its own."""
SENSORS = {"acc": "Accelerometer", "gyro": "Gyro", "mag": "Magnetometer", "thermal": "Thermocouples"}


def day(time: datetime) -> str:
    """Date and time, UTC."""
    return f"{time:%Y-%m-%d %H:%M} UTC"


def notices(records: Sequence[CalibrationRecord], say: Say) -> Iterator[Section]:
    """What a reader must know before all else, framed below the title."""
    if any(record.stand is not None and record.stand.emulated for record in records):
        words = say("Unit and stand were emulated by software: this certifies nothing about a real unit.")
        yield Section("", (Paragraph(words, "warning"),))


def item_section(records: Sequence[CalibrationRecord], details: CertificateDetails, say: Say) -> Section:
    """The unit, its owner and the dates."""
    customer, record = details.customer, records[0]
    measured = [one.measured_at for one in records if one.measured_at]
    sensors = dict.fromkeys(sensor_words(one.sensor, say) for one in records)
    rows = [
        (say("Customer"), customer.name or say("not stated")),
        (say("Address"), customer.address),
        (say("Order"), customer.reference),
        (say("Product"), f"{product_words(record.product, say)} ({record.product})"),
        (say("Type"), details.unit_type),
        (say("Manufacturer"), details.manufacturer),
        (say("Serial number"), record.serial),
        (say("Sensor"), ", ".join(sensors)),
        (say("Received"), details.received.isoformat() if details.received else ""),
        (say("Measured"), _days(measured) if measured else say("not stated")),
        (say("Evaluated"), _days([one.created_at for one in records])),
        (say("Issued"), details.issued.isoformat() if details.issued else ""),
    ]
    return Section(say("Item calibrated"), (facts(rows),))


def product_words(product: str, say: Say) -> str:
    """The product's name for people."""
    return say(PRODUCTS[product]) if product in PRODUCTS else capital(quantity_words(product, say))


def _days(times: Sequence[datetime]) -> str:
    first, last = day(min(times)), day(max(times))
    return first if first == last else f"{first} … {last}"


def sensor_words(sensor: str, say: Say) -> str:
    """The sensor's name for people."""
    kind, _, axis = sensor.partition("_")
    if kind not in SENSORS:
        return capital(quantity_words(sensor, say))
    return f"{say(SENSORS[kind])} {axis}".strip()


def method_section(
    record: CalibrationRecord, say: Say, language: str, before: Iterable[tuple[str, str]] = ()
) -> Section:
    """Method, its source and what is corrected in it, model, frames, where the result holds.

    `before`: more facts, ahead of these.
    """
    words = method_words(record.method, record.model.name, say)
    rows = [
        (say("Method"), capital(words.title)),
        (say("Source"), words.source),
        *(("" if k else say("Corrected form"), capital(one)) for k, one in enumerate(words.corrections)),
        (
            say("Model"),
            equation_words(translated(record.model.equation, language), say)
            or quantity_words(record.model.name, say),
        ),
        *(
            (
                say("Frame of reference, {name}", name=quantity_words(frame.name, say)),
                translated(frame.definition, language),
            )
            for frame in record.frames
        ),
        (say("Valid at"), temperatures([record.valid_temperature])),
    ]
    if record.plan is not None:
        plan = record.plan
        rows.append(
            (say("Test plan"), f"{plan.name} {plan.version}, {plan.operation}, SHA-256 {plan.sha256}")
        )
    return Section(say("Method"), (facts([*before, *rows]),))


def traceability_section(
    records: Sequence[CalibrationRecord], details: CertificateDetails, say: Say
) -> Section:
    """Stands and instruments with their due dates, recordings and software."""
    blocks = (*_standards(records, details, say), *_sources(records, say))
    return Section(say("Standards and traceability"), blocks)


def _standards(
    records: Sequence[CalibrationRecord], details: CertificateDetails, say: Say
) -> Iterator[Block]:
    stands = {record.stand.id: record.stand for record in records if record.stand is not None}
    rows = [
        (capital(quantity_words(one.kind, say)), one.id, "", "", _due(one.calibration_due, say))
        for one in stands.values()
    ]
    rows += [
        (one.name, one.id, one.accuracy, one.certificate, _due(one.calibration_due, say))
        for one in details.standards
    ]
    if rows:
        headings = (
            say("Standard"),
            say("Number"),
            say("Accuracy"),
            say("Certificate"),
            say("Calibration due"),
        )
        yield without_empty_columns(Grid("", headings, tuple(rows), "lllll"))
    else:
        yield Paragraph(say("The recordings name no stand: the result is traceable to what they state only."))
    if any(one.stand is not None and one.stand.calibration_overdue for one in records):
        yield Paragraph(
            say("The calibration of the stand was overdue at the time of the measurement."), "warning"
        )
    last_use = max(record.time for record in records).date()
    late = [one.name for one in details.standards if one.calibration_due and one.calibration_due < last_use]
    if late:
        names = ", ".join(late)
        yield Paragraph(say("Overdue at the time of the measurement: {names}.", names=names), "warning")


def _due(date_due: date | None, say: Say) -> str:
    return date_due.isoformat() if date_due else say("not stated")


def _sources(records: Sequence[CalibrationRecord], say: Say) -> Iterator[Block]:
    recordings = dict.fromkeys(
        (one.recording_id, say(one.form), one.sha256) for record in records for one in record.recordings
    )
    yield Grid("", (say("Recording"), say("Form"), say("SHA-256 of the recording")), tuple(recordings), "lll")
    codes = dict.fromkeys(
        record.code.package + (f", {record.code.commit}" if record.code.commit else "") for record in records
    )
    yield Facts(((say("Software"), "; ".join(codes)),))


def environment_section(
    records: Sequence[CalibrationRecord], details: CertificateDetails, say: Say
) -> Section:
    """Temperatures, place, gravity."""
    found = [record.environment for record in records]
    latitudes = dict.fromkeys(one.latitude_deg for one in found if one.latitude_deg is not None)
    gravities = dict.fromkeys(one.gravity_m_s2 for one in found if one.gravity_m_s2 is not None)
    block = facts(
        [
            (say("Temperature of the unit"), temperatures(one.unit_temperature for one in found)),
            (say("Temperature around it"), temperatures(one.stand_temperature for one in found)),
            (say("Relative humidity"), details.relative_humidity),
            (say("Latitude"), ", ".join(f"{plain(one, 7)}°" for one in latitudes)),
            (say("Gravity"), ", ".join(f"{plain(one, 8)} m/s²" for one in gravities)),
        ]
    )
    block = block if block.rows else Facts(((say("Environment"), say("not stated")),))
    return Section(say("Environment"), (block,))


def left_out_blocks(record: CalibrationRecord, say: Say, language: str) -> tuple[Block, ...]:
    """What no coefficient rests on, and why."""
    if not record.not_used:
        return (Paragraph(say("Everything in the data was used.")),)
    rows = tuple(
        (
            sentence_words(translated(one.what, language)),
            str(one.count),
            sentence_words(translated(one.why, language)),
        )
        for one in record.not_used
    )
    return (Grid("", (say("What"), say("Samples"), say("Why")), rows, "lrl"),)


def temperatures(spans: Iterable[TemperatureSpan | None]) -> str:
    """'22.6 °C … 23.4 °C' over all of them; empty where none is known."""
    known = [one for one in spans if one is not None]
    if not known:
        return ""
    edges = (min(one.low_c for one in known), max(one.high_c for one in known))
    low, high = (f"{one:.1f}".replace("-", "−") for one in (edges[0] + 0.0, edges[1] + 0.0))
    return f"{low} °C" if low == high else f"{low} °C … {high} °C"
