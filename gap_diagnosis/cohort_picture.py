# pyright: strict
"""One parameter by unit and stand with 95 % intervals, as SVG without words."""

from collections.abc import Sequence

import numpy as np

from gap_diagnosis.cohort import ParameterFindings
from gap_diagnosis.field_units import field_unit, unit_sign
from gap_diagnosis.report_pictures import panel_of, svg_of

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a7a7a")
EXPANDED = 1.96
MAX_NAMES = 14


def stand_colours(stands: Sequence[str]) -> dict[str, str]:
    """Each stand's colour, in order; they repeat after `COLOURS`."""
    return {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(stands)}


def parameter_svg(one: ParameterFindings, stands: Sequence[str]) -> str:
    """Units along the axis, stands side by side in their colours, and bands of the stands' common values."""
    values = np.array([value for _, value, _ in one.estimates])
    factor, unit = field_unit(one.unit, float(np.abs(values).max()))
    figure, panel = panel_of()
    colours = stand_colours(stands)
    place = {name: i for i, name in enumerate(one.units)}
    width = 0.6 / max(len(stands), 1)
    for mount, value, u in one.estimates:
        x = place[mount.serial] + width * (list(colours).index(mount.stand_id) - 0.5 * (len(stands) - 1))
        panel.errorbar(
            [x],
            [factor * value],
            yerr=[factor * EXPANDED * u],
            fmt="o",
            markersize=3,
            color=colours[mount.stand_id],
            linewidth=1.0,
        )
    panel.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    step = max(1, -(-len(one.units) // MAX_NAMES))
    shown = list(one.units)[::step]
    panel.set_xticks([place[name] for name in shown], shown, rotation=30, ha="right", fontsize=6)
    panel.set_ylabel(unit_sign(unit))
    return svg_of(figure, f"cohort {one.sensor} {one.name} {values[0]:.9g}")
