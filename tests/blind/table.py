"""The scorer's rows as a plain table."""

from collections.abc import Sequence

from rich.table import Table

from tests.blind.scorer import Row

STATES = {"met": "[green]met[/]", "short": "[bold red]short[/]", "open": "[yellow]open[/]", "": "–"}


def table(rows: Sequence[Row]) -> Table:
    """Every row with its bounds; `open` means that the bounds still hold the goal."""
    drawn = Table(title="Blind check of the gap diagnosis", header_style="bold")
    for heading in (
        "metric",
        "value",
        "95 % bounds",
        "cases",
        "goal",
        "",
        "oracle",
        "plain BIC",
        "un-whitened",
    ):
        drawn.add_column(heading, justify="left" if heading in ("metric", "goal") else "right")
    for row in rows:
        bounds = "" if row.low is None or row.high is None else f"{row.low:.3f} … {row.high:.3f}"
        drawn.add_row(row.metric, _figure(row.value), bounds, str(row.cases), row.goal, STATES[row.state],
                      _figure(row.oracle), _figure(row.bic), _figure(row.unwhitened))  # fmt: skip
    return drawn


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
