"""A unit's page as HTML: where it is, its attempts, measurements against limits, recordings."""

from dashboards.floor_markup import quiet
from dashboards.icons import icon
from dashboards.markup import Html, div, element, join, span
from dashboards.unit_view import AttemptRow, LimitBar, MeasurementRow, StepRow, UnitView
from dashboards.view_models import Sentence
from dashboards.words import (
    DISPOSITION_WORDS,
    FAULT_WORDS,
    OUTCOME_WORDS,
    SECTION_WORDS,
    duration,
    operation_word,
    sentence_words,
    timestamp,
)
from protocol.attempts import RecordingReference
from protocol.language import say
from protocol.line_views import UnitStatus
from protocol.outcomes import MeasurementOutcome, Outcome

_OUTCOME_ICONS = {"PASS": "passed", "FAIL": "failed"}


def outcome_badge(outcome: Outcome | MeasurementOutcome, language: str) -> Html:
    """An outcome in colour, shape and word."""
    name = _OUTCOME_ICONS.get(outcome.value, "not_judged")
    return span(f"badge {name}", icon(name), say(OUTCOME_WORDS[outcome.value], language=language))


def unit_heading(view: UnitView, language: str) -> Html:
    """Serial, disposition, product, lot and where the unit is now."""
    status = view.status
    facts = [
        (say("Product", language=language), status.unit.product),
        (say("Lot", language=language), status.unit.lot),
        (say("Now", language=language), whereabouts(status, language)),
        (say("Attempts", language=language), str(len(view.attempts))),
    ]
    if view.set_aside:
        facts.append((say("Set aside", language=language), str(view.set_aside)))
    outcomes = [
        span("route", operation_word(operation, language), outcome_badge(outcome, language))
        for operation, outcome in view.outcomes
    ]
    disposition = status.disposition.value
    return div(
        "unit-heading",
        element(
            "h1",
            status.unit.serial,
            span(
                f"badge large {disposition.lower()}", say(DISPOSITION_WORDS[disposition], language=language)
            ),
        ),
        element("dl", *(join((element("dt", name), element("dd", value))) for name, value in facts)),
        div("routes", *outcomes),
    )


def whereabouts(status: UnitStatus, language: str) -> str:
    """Where the unit is, in words."""
    if status.operation is None:
        return say("has left the line", language=language)
    operation = operation_word(status.operation, language)
    if status.station is not None:
        place = status.station if status.socket is None else f"{status.station} / {status.socket}"
        return say("at {place}: {operation}", language=language, place=place, operation=operation)
    words = say("waits for {operation}", language=language, operation=operation)
    if status.queue_position is not None:
        words += ", " + say("place {position}", language=language, position=status.queue_position)
    why = Sentence(status.waits_for, status.waits_for_template, status.waits_for_values)
    return f"{words} ({sentence_words(why, language)})" if status.waits_for else words


def attempt_card(attempt: AttemptRow, language: str) -> Html:
    """One attempt with everything it left behind."""
    badges = [outcome_badge(attempt.outcome, language)]
    if attempt.fault.value != "none":
        badges.append(span("badge fault", say(FAULT_WORDS[attempt.fault.value], language=language)))
    if attempt.set_aside:
        badges.append(span("badge set-aside", say("set aside", language=language)))
    heading = element(
        "header",
        span("number", f"{attempt.number}"),
        element("h2", operation_word(attempt.operation, language)),
        *badges,
        span("place", f"{attempt.station} / {attempt.socket}"),
        span("when", timestamp(attempt.started_at_s)),
    )
    return element(
        "article",
        heading,
        *_attempt_notes(attempt, language),
        _steps_table(attempt.steps, language)
        if attempt.steps
        else quiet(say("no step was run", language=language)),
        _recordings(attempt, language),
        _attempt_facts(attempt, language),
        class_=f"attempt {'set-aside' if attempt.set_aside else ''}".strip(),
        data_attempt=attempt.attempt_id,
    )


def _attempt_notes(attempt: AttemptRow, language: str) -> list[Html]:
    notes: list[Html] = []
    if attempt.set_aside:
        words = say(
            "The lease of this attempt had been revoked: the record is kept, it did not move the unit.",
            language=language,
        )
        notes.append(div("note-line", words))
    if attempt.message:
        notes.append(div("note-line", attempt.message))
    if not attempt.safe_state:
        words = say("The station did not confirm that the unit was left powered off.", language=language)
        notes.append(div("note-line warning", icon("not_judged"), words))
    notes.extend(div("note-line problem", icon("failed"), problem) for problem in attempt.problems)
    return notes


def _steps_table(steps: tuple[StepRow, ...], language: str) -> Html:
    titles = (
        say("Measurement", language=language),
        say("Value", language=language),
        say("Low", language=language),
        say("Against its limits", language=language),
        say("High", language=language),
        say("Margin", language=language),
        say("Outcome", language=language),
    )
    head = element("thead", element("tr", *(element("th", title, scope="col") for title in titles)))
    bodies = [_step_rows(step, language) for step in steps]
    return div("table-scroll", element("table", head, *bodies, class_="measurements"))


def _step_rows(step: StepRow, language: str) -> Html:
    section = "" if step.section == "main" else say(SECTION_WORDS[step.section], language=language)
    title = element(
        "tr",
        element(
            "th",
            span("step-name", step.step),
            span("section", section),
            span("elapsed", f"{step.duration_s:.3g} s"),
            span("message", step.message),
            colspan=6,
            scope="rowgroup",
        ),
        element("td", outcome_badge(step.outcome, language)),
        class_="step",
    )
    return element("tbody", title, *(_measurement_row(row, language) for row in step.measurements))


def _measurement_row(row: MeasurementRow, language: str) -> Html:
    value = f"{row.value} {row.unit}".strip() if row.value else "–"
    if row.equals:
        against = say("must be {value}", language=language, value=row.equals)
        middle = element("td", against, class_="bar equals")
    else:
        middle = element("td", _bar(row.bar, row.outcome) if row.bar else "", class_="bar")
    margin = row.margin
    if row.margin_fraction is not None:
        margin = f"{row.margin} ({row.margin_fraction * 100:.0f} %)"
    return element(
        "tr",
        element("td", row.name, span("message", row.message), class_="name"),
        element("td", value, class_="number value"),
        element("td", row.low, class_="number"),
        middle,
        element("td", row.high, class_="number high"),
        element("td", margin, class_="number margin"),
        element("td", outcome_badge(row.outcome, language)),
        class_=f"measurement {row.outcome.value.lower()}",
        data_measurement=row.name,
    )


def _bar(bar: LimitBar, outcome: MeasurementOutcome) -> Html:
    """The allowed range as a band, the value as a mark, ±2 standard uncertainties as a whisker."""
    low = 0.0 if bar.low_at is None else bar.low_at
    high = 1.0 if bar.high_at is None else bar.high_at
    parts = [div("allowed", style=f"left:{low * 100:.1f}%;width:{(high - low) * 100:.1f}%")]
    parts += [
        div("limit", style=f"left:{at * 100:.1f}%") for at in (bar.low_at, bar.high_at) if at is not None
    ]
    if bar.spread is not None:
        start, end = bar.spread
        parts.append(div("whisker", style=f"left:{start * 100:.1f}%;width:{(end - start) * 100:.1f}%"))
    mark = f"mark {outcome.value.lower()}" + (f" off-{bar.off_scale}" if bar.off_scale else "")
    parts.append(div(mark, style=f"left:{bar.value_at * 100:.1f}%"))
    return div("limit-bar", *parts)


def _recordings(attempt: AttemptRow, language: str) -> Html:
    if not attempt.recordings:
        return Html("")
    rows = [_recording(recording, attempt.station, language) for recording in attempt.recordings]
    return div("recordings", element("h3", say("Recordings", language=language)), *rows)


def _recording(recording: RecordingReference, station: str, language: str) -> Html:
    words = say(
        "{samples} samples, {size}, kept at {station}",
        language=language,
        samples=f"{recording.sample_count:,}",
        size=_size(recording.size_bytes),
        station=station,
    )
    return div(
        "recording",
        div("what", recording.description, span("note", words)),
        element("code", recording.path),
        element("code", f"SHA-256 {recording.sha256}", class_="hash"),
    )


def _size(size_bytes: int) -> str:
    if size_bytes < 1_000_000:
        return f"{size_bytes / 1000:.1f} kB"
    return f"{size_bytes / 1_000_000:.1f} MB"


def _attempt_facts(attempt: AttemptRow, language: str) -> Html:
    facts = [
        say("plan {plan}", language=language, plan=attempt.plan),
        f"SHA-256 {attempt.plan_sha256[:12]}…",
        say("wall time {duration}", language=language, duration=duration(attempt.wall_s, language)),
        say(
            "bench time {duration}", language=language, duration=duration(attempt.duration_bench_s, language)
        ),
        say("lease {fence}", language=language, fence=attempt.fence),
        f"Testloom {attempt.software_version}",
        attempt.attempt_id,
    ]
    return element("footer", *(span("fact", fact) for fact in facts))
