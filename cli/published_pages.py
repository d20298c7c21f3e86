"""What people and scripts see of a published calibration beside an evaluation."""

import math
from typing import Any

from rich.console import Console
from rich.table import Table

from calibration.published import ComparedReference, Comparison
from cli.uncertain_numbers import gum, plain
from protocol.language import say, translated


def show_reference(console: Console, reference: ComparedReference | None) -> None:
    if reference is None:
        return
    table = Table(
        header_style="bold",
        box=None,
        padding=(0, 2, 0, 0),
        title=say("Beside the published calibration ({source})", source=reference.source),
        caption=say(
            "E: difference over the standard uncertainty, ours and that of the published figure; "
            "where that stands here it was evaluated here: the source states none"
        ),
    )
    for heading in ("Coefficient", "Here", "Published", "%", "E", "Unit"):
        # a number that is broken over two lines is read wrongly
        table.add_column(say(heading), overflow="fold", no_wrap=True)
    for item in reference.comparisons:
        evaluated = item.published_standard_uncertainty > item.standard_uncertainty / 10
        table.add_row(
            item.name,
            gum(item.value, item.standard_uncertainty),
            gum(item.published, item.published_standard_uncertainty)
            if evaluated
            else plain(item.published, 6),
            "" if item.percent is None else f"{item.percent:+.2f}",
            f"{item.normalised_error:+.2f}",
            item.unit,
        )
    console.print(table)
    for remark in reference.remarks:
        console.print(f"  · {translated(remark)}")


def reference_json(reference: ComparedReference) -> dict[str, Any]:
    return {
        "source": reference.source,
        "remarks": list(reference.remarks),
        "comparisons": [_comparison_json(item) for item in reference.comparisons],
    }


def _comparison_json(item: Comparison) -> dict[str, Any]:
    error = item.normalised_error
    return {
        "name": item.name,
        "value": item.value,
        "published": item.published,
        "difference": item.difference,
        "percent": item.percent,
        "standard_uncertainty": item.standard_uncertainty,
        "published_standard_uncertainty": item.published_standard_uncertainty,
        "normalised_error": error if math.isfinite(error) else None,
        "unit": item.unit,
    }
