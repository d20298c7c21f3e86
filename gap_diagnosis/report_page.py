# pyright: strict
"""report.html: one file without a network, for a phone, a desk and paper, in the chosen language.

The same report gives the same bytes. Words and numbers come from `report_words`, pictures from
`report_pictures`; here is what stands where.
"""

from collections.abc import Iterable, Sequence
from html import escape

from gap_diagnosis.field_units import number, unit_sign
from gap_diagnosis.page_markup import bar, cards, page, section
from gap_diagnosis.report import GapReport, HeatCell, ResidualSeries, Spectrum
from gap_diagnosis.report_document import ReportDocument, Shrinkage
from gap_diagnosis.report_pictures import Picture, legend_colours
from gap_diagnosis.report_style import VERDICT_COLOURS, heat_colour
from gap_diagnosis.report_words import (
    KINDS,
    channel_words,
    channels_words,
    closed_words,
    effect_words,
    parameter_lines,
    regime_words,
    set_words,
    span_words,
    variable_words,
    verdict_sentences,
    verdict_words,
)
from protocol.language import say, translated

MAX_PLACES, MAX_RANKED = 20, 12
SIGNIFICANT = 0.05


def report_html(report: GapReport, document: ReportDocument, drawn: Sequence[Picture]) -> str:
    """The page.

    Args:
        report: for the map of where.
        document: report.json as it was written.
        drawn: the report's pictures.
    """
    parts = (
        _verdict(document),
        _where(document, report.heat),
        _which(document),
        _shrinkage(document),
        _residuals(drawn, len(report.series)),
        _spectra(drawn),
        _not_used((*report.not_used, *document.not_used)),
        _next_test(document),
        _rests_on(document),
    )
    title = say("Gap report: {verdict}", verdict=verdict_words(document))
    return page(title, parts)


def _verdict(document: ReportDocument) -> str:
    colour = VERDICT_COLOURS[document.verdict]
    units = ", ".join(dict.fromkeys(one.serial for one in document.recordings if one.serial))
    about = " · ".join(text for text in (document.product, units) if text)
    said = "".join(f"<p>{escape(sentence)}</p>" for sentence in verdict_sentences(document))
    return (
        f"<header><p class=about>{escape(say('Simulator against recordings'))}"
        + (f" · {escape(about)}" if about else "")
        + f'</p><h1 style="border-color:{colour}">{escape(verdict_words(document))}</h1>'
        f"<div class=said>{said}</div></header>"
    )


def _where(document: ReportDocument, heat: Sequence[HeatCell]) -> str:
    by_variable: dict[str, list[HeatCell]] = {}
    for cell in sorted(heat, key=lambda cell: -abs(cell.sigmas)):  # what stands out most comes first
        by_variable.setdefault(cell.variable, [])
    for cell in heat:
        by_variable[cell.variable].append(cell)
    maps = "".join(_heat_map(variable, cells) for variable, cells in by_variable.items())
    places = document.where[:MAX_PLACES]
    rows = [
        (
            channel_words(place.channel),
            regime_words(place),
            say(KINDS[place.kind]),
            _p(place.p_adjusted) + (f" ({say('fitted tail')})" if place.fitted_tail else ""),
            f"{number(place.excess_rms)} {unit_sign(place.unit)}",
        )
        for place in places
    ]
    headings = (say("Channel"), say("Where"), say("Kind"), "p", say("Excess, rms"))
    table = _table(headings, rows) if rows else f"<p>{escape(say('Nothing stands out anywhere.'))}</p>"
    more = len(document.where) - len(places)
    remark = (
        f"<p class=remark>{escape(say('{count} more in report.json', count=more))}</p>" if more > 0 else ""
    )
    note = say(
        "Numbers are standard deviations of the noise that was expected; a frame marks what is significant "
        "after all cells were looked at (p < 0.05)."
    )
    legend = f"<p class=remark>{escape(note)}</p>" if maps else ""
    return section(say("Where the gap lies"), maps + legend + table + remark)


def _heat_map(variable: str, cells: Sequence[HeatCell]) -> str:
    """Channels down, ranges of one variable across."""
    spans = sorted({(cell.low, cell.high) for cell in cells})
    by_place = {(cell.channel, cell.low, cell.high): cell for cell in cells}
    unit = unit_sign(cells[0].unit)
    heading = f"{variable_words(variable)}, {unit}" if unit else variable_words(variable)
    head = "".join(f"<th>{span_words(low, high)}</th>" for low, high in spans)
    rows = "".join(
        f"<tr><th>{escape(channel_words(channel))}</th>"
        + "".join(_heat_cell(by_place.get((channel, *span))) for span in spans)
        + "</tr>"
        for channel in dict.fromkeys(cell.channel for cell in cells)
    )
    return (
        f"<div class=scroll><table class=heat><caption>{escape(heading)}</caption>"
        f"<thead><tr><th></th>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _heat_cell(cell: HeatCell | None) -> str:
    if cell is None:
        return "<td class=none>·</td>"
    ground, ink = heat_colour(cell.sigmas)
    mark = " class=sharp" if cell.p_adjusted < SIGNIFICANT else ""
    title = escape(f"p = {_p(cell.p_adjusted)}")
    shown = f"{cell.sigmas:.1f}".replace("-", "−")
    return f'<td{mark} style="background:{ground};color:{ink}" title="{title}">{shown}</td>'


def _which(document: ReportDocument) -> str:
    if not document.which:
        return ""
    rows = [
        (
            f"<div><b>{escape(effect_words(entry.effect))}</b><br><code>{escape(entry.effect)}</code></div>",
            bar(entry.probability),
            escape(channels_words(entry.channels)),
            _lines(parameter_lines(entry)),
            _lines([effect_words(name) for name in entry.confusable_with]),
        )
        for entry in document.which[:MAX_RANKED]
    ]
    headings = (
        say("Effect"),
        say("Probability"),
        say("Channels"),
        say("Parameters, value ± standard uncertainty"),
        say("This test cannot tell it from"),
    )
    sets = [(escape(set_words(one.effects)), bar(one.probability)) for one in document.sets[:MAX_RANKED]]
    together = (
        f"<h3>{escape(say('What acts together'))}</h3>" + cards((say("Effect"), say("Probability")), sets)
        if sets
        else ""
    )
    return section(say("Which effect causes it"), cards(headings, rows) + together)


def _shrinkage(document: ReportDocument) -> str:
    shrinkage = document.shrinkage
    if shrinkage is None:
        return ""
    closed = f"<p class=figure>{escape(closed_words(shrinkage))}</p>"
    judged = say("Judged on: {parts}.", parts=_parts(shrinkage))
    if document.verdict == "unattributed":
        told = say("of the gap closes with the best combination of known effects.")
    else:
        told = say("of the gap closes once the effect is in the simulator.")
    rows = [
        (
            say("all channels, whitened"),
            number(shrinkage.before),
            number(shrinkage.after),
            "–" if shrinkage.noise_floor is None else number(shrinkage.noise_floor),
            "1",
        )
    ]
    rows += [
        (
            channel_words(channel),
            number(one.before),
            number(one.after),
            "–" if one.noise_floor is None else number(one.noise_floor),
            unit_sign(one.unit),
        )
        for channel, one in shrinkage.channels.items()
    ]
    headings = (say("Residual, rms"), say("Before"), say("After"), say("Noise floor"), say("Unit"))
    note = say(
        "Whitened: each residual divided by the noise expected there, slow noise taken into account; noise "
        "alone gives 1."
    )
    body = f"{closed}<p>{escape(told)} {escape(judged)}</p>{_table(headings, rows)}"
    body += f"<p class=remark>{escape(note)}</p>"
    return section(say("How far it shrinks"), body)


def _parts(shrinkage: Shrinkage) -> str:
    return ", ".join(translated(part) for part in shrinkage.held_out) or say("data within the run")


def _residuals(drawn: Sequence[Picture], known: int) -> str:
    figures = [
        (f"{channel_words(one.shows.channel)} · {one.shows.recording_id}", one.svg)
        for one in drawn
        if isinstance(one.shows, ResidualSeries)
    ]
    if not figures:
        return ""
    left = known - len(figures)
    words = say("{count} more that changed less are not drawn.", count=left) if left else ""
    return section(say("Residuals before and after"), _legend(2) + _figures(figures, words))


def _spectra(drawn: Sequence[Picture]) -> str:
    names = {"allan": say("Allan deviation"), "psd": say("Density over frequency")}
    figures = [
        (f"{channel_words(one.shows.channel)} · {names[one.shows.kind]}", one.svg)
        for one in drawn
        if isinstance(one.shows, Spectrum)
    ]
    if not figures:
        return ""
    return section(say("Noise: seen and believed"), _legend(3) + _figures(figures, ""))


def _legend(count: int) -> str:
    words = {"before": say("before"), "after": say("after"), "believed": say("as the simulator believes")}
    marks = "".join(
        f'<span><i style="border-top:3px {"dashed" if dashed else "solid"} {colour}"></i>'
        f"{escape(words[word])}</span>"
        for word, colour, dashed in legend_colours()[:count]
    )
    return f"<p class=legend>{marks}</p>"


def _figures(figures: Iterable[tuple[str, str]], remark: str) -> str:
    drawn = "".join(
        f"<figure><figcaption>{escape(caption)}</figcaption>{svg}</figure>" for caption, svg in figures
    )
    below = f"<p class=remark>{escape(remark)}</p>" if remark else ""
    return f"<div class=figures>{drawn}</div>{below}"


def _not_used(sentences: Sequence[str]) -> str:
    listed = list(dict.fromkeys(sentences))
    if not listed:
        body = f"<p>{escape(say('Everything in the data was used.'))}</p>"
    else:
        body = "<ul>" + "".join(f"<li>{escape(translated(one))}</li>" for one in listed) + "</ul>"
    return section(say("What could not be used"), body)


def _next_test(document: ReportDocument) -> str:
    test = document.next_test
    if test is None:
        text = say("No test of this product's promises to tell more.")
        return section(say("The next test"), f"<p>{escape(text)}</p>")
    told = say(
        "{profile}, {minutes} min: {bits} bits of information expected.",
        profile=test.profile,
        minutes=f"{test.minutes:.3g}",
        bits=f"{test.expected_bits:.2f}",
    )
    why = (
        say(
            "Of all tests of this product it says the most per minute about which is right: {names}.",
            names=", ".join(set_words(tuple(name.split(" + "))) for name in test.separates),
        )
        if test.separates
        else ""
    )
    settings = ", ".join(f"{name} = {value:g}" for name, value in test.values.items())
    rows = [
        (
            one.profile,
            f"{one.minutes:.3g}",
            f"{one.expected_bits:.2f}",
            f"{one.expected_bits / one.minutes:.3g}",
        )
        for one in test.ranked[:MAX_RANKED]
        if one.minutes > 0
    ]
    headings = (say("Profile"), say("Minutes"), say("Expected bits"), say("Bits per minute"))
    body = f"<p><b>{escape(told)}</b></p>" + (f"<p><code>{escape(settings)}</code></p>" if settings else "")
    body += f"<p>{escape(why)}</p>" + (_table(headings, rows) if rows else "")
    return section(say("The next test"), body)


def _rests_on(document: ReportDocument) -> str:
    rows = [
        (one.recording_id, one.serial or "–", one.profile or "–", one.sha256[:16] or "–")
        for one in document.recordings
    ]
    headings = (say("Recording"), say("Serial"), say("Profile"), "SHA-256")
    table = _table(headings, rows) if rows else ""
    held = document.shrinkage.held_out if document.shrinkage else ()
    parts = ", ".join(translated(part) for part in held)
    told = say("Held out from the fit, to judge it: {parts}.", parts=parts) if parts else ""
    return section(say("What it rests on"), table + (f"<p>{escape(told)}</p>" if told else ""))


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return cards(headings, [[escape(cell) for cell in row] for row in rows])


def _lines(lines: Sequence[str]) -> str:
    return "<div>" + ("<br>".join(escape(line) for line in lines) or "–") + "</div>"


def _p(value: float) -> str:
    return f"{value:.2g}" if value >= 1e-4 else f"{value:.0e}"
