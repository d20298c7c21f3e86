"""What is said of a cohort: cohort.json, and a short table at the command line."""

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cli.cohort_runs import Cohort
from cli.cohort_units import folder_of
from gap_diagnosis.cohort import document, remarks
from gap_diagnosis.cohort_words import assigned_words, level_words
from gap_diagnosis.report_words import effect_words, percent
from protocol.language import say, translated

COHORT_FORMAT = "testloom-gap-cohort/1"
MAX_LEFT_OUT = 10


def cohort_document(cohort: Cohort) -> dict[str, Any]:
    """cohort.json: see docs/gap.md."""
    return {
        "format": COHORT_FORMAT,
        "product": cohort.product,
        "units": [
            {
                "serial": one.serial,
                "verdict": one.report.verdict if one.report is not None else None,
                "effects": list(one.report.sets[0].effects)
                if one.report is not None and one.report.sets
                else [],
                "report": f"units/{folder_of(one.serial)}/report.json" if one.report is not None else None,
                "recordings": [recording.entry() for recording in one.recordings],
            }
            for one in cohort.units
        ],
        "left_out": [{"what": one.what, "why": one.why} for one in cohort.left_out],
        **document(cohort.findings),
    }


def cohort_view(cohort: Cohort) -> Group:
    """Each cause with its level, what would tell more, and what was left out."""
    stands = {one.stand_id for one in cohort.findings.mounts}
    told: dict[str, Any] = {
        "units": len(cohort.units),
        "stands": len(stands),
        "mounts": len(cohort.findings.mounts),
    }
    kept = sum(one.kept for one in cohort.units)
    parts: list[RenderableType] = [Text(say("{units} units, {stands} stands, {mounts} mounts", **told))]
    if kept:
        parts.append(Text(say("{count} reports were there already and are kept.", count=kept), style="dim"))
    table = Table(header_style="bold")
    for heading in (say("Cause"), say("Level"), say("Probability"), say("What else")):
        table.add_column(heading, overflow="fold")
    further: list[str] = []
    for one in (*cohort.findings.effects, *cohort.findings.constants):
        chance = one.probabilities.get(one.assigned, 0.0)
        others = [
            f"{level_words(name)} {percent(p)}"
            for name, p in sorted(one.probabilities.items(), key=lambda item: -item[1])
            if name != one.assigned and p >= 0.01
        ]
        shown = percent(chance) if len(one.between) == 1 else "–"
        table.add_row(effect_words(one.effect), assigned_words(one), shown, ", ".join(others))
        further += remarks(one)
    parts.append(table)
    parts += [Text(f"→ {say(sentence)}") for sentence in dict.fromkeys(further)]
    for left in cohort.left_out[:MAX_LEFT_OUT]:
        parts.append(Text(f"{say('Left out')}: {left.what}: {translated(left.why)}", style="yellow"))
    if len(cohort.left_out) > MAX_LEFT_OUT:
        more = len(cohort.left_out) - MAX_LEFT_OUT
        parts.append(Text(say("{count} more are named in cohort.json.", count=more), style="yellow"))
    return Group(*parts)
