# pyright: strict
"""cohort.html: one file without a network; which cause goes with unit, lot, stand, mount or link."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from gap_diagnosis.cohort import CohortFindings, EffectFindings, ParameterFindings, remarks
from gap_diagnosis.cohort_picture import parameter_svg, stand_colours
from gap_diagnosis.cohort_words import assigned_words, level_words
from gap_diagnosis.field_units import field_quantity, field_unit, number, unit_sign
from gap_diagnosis.page_markup import bar, cards, page, section
from gap_diagnosis.report_words import effect_words, verdict_name
from protocol.language import say, translated

MAX_PARAMETERS = 6
MAX_ROWS = 500
SHOWN_FROM = 0.01


def cohort_html(findings: CohortFindings, document: Mapping[str, Any]) -> str:
    """The page; `document`: cohort.json."""
    title = say("Unit or stand? {product}", product=document["product"])
    stands = list(dict.fromkeys(one.stand_id for one in findings.mounts))
    told: dict[str, Any] = {
        "units": len(document["units"]),
        "stands": len(stands),
        "mounts": len(findings.mounts),
    }
    parts = [
        f"<header><h1>{escape(title)}</h1><div class=said><p>"
        f"{escape(say('{units} units, {stands} stands, {mounts} mounts', **told))}</p></div></header>",
        _summary((*findings.effects, *findings.constants)),
        _effects(say("Causes that diagnoses found"), findings.effects, stands),
        _effects(say("Constants of mounts and stands"), findings.constants, stands),
        _pairs(findings),
        _units(document["units"]),
        _left_out(document["left_out"]),
    ]
    return page(title, parts)


def _summary(effects: Sequence[EffectFindings]) -> str:
    if not effects:
        return f"<p>{escape(say('No cause was found on any unit.'))}</p>"
    rows: list[list[str]] = []
    further: list[str] = []
    for one in effects:
        chances = "<br>".join(
            f"{bar(p)} {escape(level_words(name))}"
            for name, p in sorted(one.probabilities.items(), key=lambda item: -item[1])
            if p >= SHOWN_FROM
        )
        rows.append([escape(effect_words(one.effect)), f"<b>{escape(assigned_words(one))}</b>", chances])
        further += remarks(one)
    more = "".join(f"<li>{escape(say(sentence))}</li>" for sentence in dict.fromkeys(further))
    listed = f"<h3>{escape(say('What would tell them apart'))}</h3><ul>{more}</ul>" if more else ""
    return cards([say("Cause"), say("Level"), say("Probability")], rows) + listed


def _effects(heading: str, effects: Sequence[EffectFindings], stands: Sequence[str]) -> str:
    if not effects:
        return ""
    legend = "".join(
        f'<span><i style="border-top:3px solid {colour}"></i>{escape(name or "–")}</span>'
        for name, colour in stand_colours(stands).items()
    )
    parts = [f"<p class=legend>{legend}</p>"]
    for one in effects:
        clear = sorted(one.parameters, key=lambda p: (p.parts.nothing, -p.parts.log_evidence))
        parts.append(f"<h3>{escape(effect_words(one.effect))}: {escape(assigned_words(one))}</h3>")
        parts.append("<div class=figures>")
        parts += [_parameter(parameter, stands) for parameter in clear[:MAX_PARAMETERS]]
        parts.append("</div>")
    return section(heading, "".join(parts))


def _parameter(one: ParameterFindings, stands: Sequence[str]) -> str:
    """Values by unit and stand, and under them the mean square of each level as bars."""
    total = sum(part.mean_square for part in one.parts.parts)
    largest = max((part.deviation for part in one.parts.parts), default=0.0)
    factor, unit = field_unit(one.unit, largest or max(abs(v) for _, v, _ in one.estimates))
    rows: list[list[str]] = []
    for part in one.parts.parts:
        names = ", ".join(level_words(level) for level in part.levels)
        low, high = (number(factor * end) for end in part.interval95)
        deviation = f"{number(factor * part.deviation)} ({low} … {high}) {unit_sign(unit)}"
        rows.append([escape(names), bar(part.mean_square / total if total > 0 else 0.0), escape(deviation)])
    name = " ".join(text for text in (one.sensor, one.name) if text)
    table = cards([say("Level"), say("Share of the variance"), say("Standard deviation (95 %)")], rows)
    return f"<figure>{parameter_svg(one, stands)}<figcaption>{escape(name)}</figcaption>{table}</figure>"


def _pairs(findings: CohortFindings) -> str:
    if not findings.pairs:
        return ""
    rows = [
        [
            escape(one.serial),
            escape(f"{one.first[0]} {one.first[1]} → {one.second[0]} {one.second[1]}"),
            escape(
                ", ".join(
                    f"{1e3 * value:.3f} ± {1e3 * u:.3f}"
                    for value, u in zip(one.rotation_rad, one.standard_uncertainty_rad, strict=True)
                )
            ),
            ""
            if one.rate_share is None
            else escape(field_quantity(one.rate_share, "1", one.rate_share_uncertainty)),
            f"{one.p:.2g}",
        ]
        for one in findings.pairs[:MAX_ROWS]
    ]
    headings = [
        say("Serial number"),
        say("Mounts"),
        say("Rotation x, y, z, mrad"),
        say("Rate of the stands"),
        say("p of what is left"),
    ]
    remark = say("The rotation between two mounts that gyro and accelerometer have in common.")
    table = f"<p class=remark>{escape(remark)}</p>{cards(headings, rows)}"
    return section(say("Mount against mount"), table)


def _units(units: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [
            escape(one["serial"]),
            escape(verdict_name(one["verdict"])) if one["verdict"] else "–",
            escape(", ".join(effect_words(name) for name in one["effects"])),
            f'<a href="{escape(one["report"].replace(".json", ".html"))}">{escape(say("report"))}</a>'
            if one["report"]
            else "",
        ]
        for one in units[:MAX_ROWS]
    ]
    headings = [say("Serial number"), say("Verdict"), say("Effects found"), ""]
    return section(say("Units and their reports"), cards(headings, rows))


def _left_out(entries: Sequence[Mapping[str, str]]) -> str:
    if not entries:
        return ""
    items = "".join(
        f"<li><code>{escape(one['what'])}</code> {escape(translated(one['why']))}</li>"
        for one in entries[:MAX_ROWS]
    )
    return section(say("Left out"), f"<ul>{items}</ul>")
