"""What people see of a gap report at the command line."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gap_diagnosis.field_units import field_quantity, number, unit_sign
from gap_diagnosis.report_document import ReportDocument, Shrinkage
from gap_diagnosis.report_words import (
    channel_words,
    channels_words,
    closed_words,
    effect_words,
    parameter_lines,
    percent,
    regime_words,
    verdict_sentences,
    verdict_words,
)
from gap_diagnosis.twin_change import ParameterChange
from protocol.language import say

STYLES = {"no_gap": "green", "attributed": "bold", "confusable": "yellow", "unattributed": "bold red"}
MAX_PLACES, MAX_EFFECTS = 6, 8
HOW = {
    "new": "new",
    "replaced": "replaced",
    "added": "added to what the twin had",
    "shape": "shape",
    "left out": "left out: smaller than its uncertainty",
}


def report_view(document: ReportDocument) -> Group:
    """The verdict in words, where, and the ranked effects."""
    parts: list[RenderableType] = [Text(verdict_words(document), style=STYLES[document.verdict])]
    parts += [Text(sentence) for sentence in verdict_sentences(document)]
    if document.where:
        parts.append(_places(document))
    if document.which:
        parts.append(_effects(document))
    if document.next_test is not None:
        test = document.next_test
        told = {
            "profile": test.profile,
            "minutes": f"{test.minutes:.3g}",
            "bits": f"{test.expected_bits:.2f}",
        }
        words = say("{profile}, {minutes} min: {bits} bits of information expected.", **told)
        parts.append(Text(f"{say('The next test')}: {words}"))
    return Group(*parts)


def changes_table(changes: Sequence[ParameterChange]) -> Table:
    """What is another in the twin."""
    table = Table(header_style="bold", title=say("What is another in the twin"))
    for heading in (say("Parameter"), say("Before"), say("After"), ""):
        table.add_column(heading, overflow="fold")
    shown: tuple[str, str] | None = None
    for one in changes:
        if (one.effect, one.sensor) != shown:
            table.add_row(Text(f"{effect_words(one.effect)} ({one.sensor})", style="bold"))
            shown = (one.effect, one.sensor)
        before = "–" if one.before is None else field_quantity(one.before, one.unit)
        table.add_row(f"  {one.parameter}", before, field_quantity(one.after, one.unit), say(HOW[one.how]))
    return table


def verification_view(shrinkage: Shrinkage) -> Group:
    """What is left of a gap on new recordings."""
    title = say("The gap on recordings that were not used before")
    closed = say("closed: {share}", share=closed_words(shrinkage))
    table = Table(header_style="bold", title=title)
    headings = (say("Residual, rms"), say("Before"), say("After"), say("Noise floor"), say("Unit"))
    for heading in headings:
        table.add_column(heading)
    floor = "–" if shrinkage.noise_floor is None else number(shrinkage.noise_floor)
    table.add_row(
        say("all channels, whitened"), number(shrinkage.before), number(shrinkage.after), floor, "1"
    )
    for channel, one in shrinkage.channels.items():
        floor = "–" if one.noise_floor is None else number(one.noise_floor)
        cells = (number(one.before), number(one.after), floor, unit_sign(one.unit))
        table.add_row(channel_words(channel), *cells)
    return Group(table, Text(closed))


def _places(document: ReportDocument) -> Table:
    table = Table(header_style="bold", title=say("Where the gap lies"))
    for heading in (say("Channel"), say("Where"), "p", say("Excess, rms")):
        table.add_column(heading, overflow="fold")
    for place in document.where[:MAX_PLACES]:
        excess = f"{number(place.excess_rms)} {unit_sign(place.unit)}"
        table.add_row(channel_words(place.channel), regime_words(place), f"{place.p_adjusted:.2g}", excess)
    if len(document.where) > MAX_PLACES:
        more = say("{count} more in report.json", count=len(document.where) - MAX_PLACES)
        table.caption = more
    return table


def _effects(document: ReportDocument) -> Table:
    table = Table(header_style="bold", title=say("Which effect causes it"))
    table.add_column(say("Effect"), overflow="fold")
    table.add_column(say("Probability"), justify="right", no_wrap=True)
    table.add_column(say("Channels"), overflow="fold")
    for entry in document.which[:MAX_EFFECTS]:
        lines = Text(effect_words(entry.effect), style="bold")
        lines.append(f"\n{entry.effect}", style="not bold dim")
        for line in parameter_lines(entry):
            lines.append(f"\n  {line}", style="not bold")
        if entry.confusable_with:
            others = ", ".join(effect_words(name) for name in entry.confusable_with)
            lines.append(f"\n  {say('This test cannot tell it from')}: {others}", style="not bold yellow")
        table.add_row(lines, percent(entry.probability), channels_words(entry.channels))
    return table
