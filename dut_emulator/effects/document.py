# pyright: strict
"""docs/effects.md and its pictures, written from the catalogue: `python -m dut_emulator.effects.document`.

A test holds the files to what this module writes.
"""

import inspect
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from dut_emulator.effects.catalogue import CATALOGUE, KINDS
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stage, name_of
from dut_emulator.effects.parameters import Declaration, declarations, range_for, unit_for
from dut_emulator.effects.pictures import caption, pictures

_OPENING = """# The catalogue of effects

Written by `python -m dut_emulator.effects.document`, text and pictures; a test holds them to the code. A
picture is the effect itself, applied to a motion that shows it.

An effect lies between what acts on a sensor and the numbers that arrive. It is a frozen object of parameters
with a stage; a chain applies a triad's effects stage by stage, since they do not commute:
{stages}.
White noise, which is stated for the output, comes behind the filter, and what is late or jitters before that
noise: the signal is of another moment, the noise of each sample is its own.

The emulator applies an effect, a diagnosis fits the same object: `basis` is the derivative of `apply`,
`guess` finds the parameters in a residual. A twin file (`dut_emulator/twin.py`) keeps a unit's effects.

Parameters are in SI units. A triple is one number for each axis (x, y, z), a matrix has a row for each sensor
and a column for each axis. *Held* parameters give a contribution its shape and are not fitted linearly;
those marked *scanned* are looked for by `guess`.

Names are `gyro.`, `acc.`, `mag.`, `gnss.`, `link.` and `stand.`; the last two act on the triad that a chain
belongs to. Papers are those of [papers.md](papers.md).
"""


def document() -> str:
    """The whole text."""
    stages = " → ".join(stage.name.lower() for stage in Stage)
    parts = [_OPENING.format(stages=stages), _table(), *(_section(kind) for kind in KINDS)]
    return "\n".join(parts)


def _names(kind: type[CatalogueEffect]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name_of(kind(sensor)) for sensor in kind.sensors))


def _table() -> str:
    rows = [f"| {', '.join(_names(kind))} | {kind.stage.name.lower()} | {_kind_of(kind)} |" for kind in KINDS]
    heading = f"{len(CATALOGUE)} names, {len(KINDS)} effects.\n\n| names | stage | kind |\n|---|---|---|"
    return "\n".join([heading, *rows, ""])


def _kind_of(kind: type[CatalogueEffect]) -> str:
    return "stochastic" if kind.stochastic else "deterministic"


def _section(kind: type[CatalogueEffect]) -> str:
    words = kind.word.replace("_", " ")
    lines = [f"## {words[0].upper()}{words[1:]}", "", f"`{'`, `'.join(_names(kind))}`", ""]
    lines += [inspect.cleandoc(kind.__doc__ or ""), ""]
    lines += [f"![{words}](effects/{kind.word}.svg)", "", f"*Picture:* {caption(kind)}", ""]
    if kind.origin:
        lines += [f"*Acts on:* {', '.join(kind.sensors)}", ""]
    if kind.valid:
        lines += [f"*Valid:* {kind.valid}", ""]
    lines += ["| parameter | unit | range | default | what it is |", "|---|---|---|---|---|"]
    defaults = {item.name: item.default for item in fields(kind)}
    for name, declaration in declarations(kind).items():
        lines.append(_parameter(kind, name, declaration, defaults[name]))
    if "axis" in defaults:
        lines.append("| `axis` |  | outer, middle, inner | inner | the stand's axis whose angle it follows |")
    return "\n".join([*lines, ""])


def _parameter(kind: type[CatalogueEffect], name: str, declaration: Declaration, default: Any) -> str:
    units = dict.fromkeys(unit_for(declaration.unit, sensor) for sensor in kind.sensors)
    ranges = dict.fromkeys(
        " to ".join(f"{bound:g}" for bound in range_for(declaration, sensor)) for sensor in kind.sensors
    )
    state = "; scanned" if name in kind.scanned else "; held" if declaration.held else ""
    return (
        f"| `{name}` | {' or '.join(units)} | {' or '.join(ranges)} | {_shape(default, declaration)} | "
        f"{declaration.meaning}{state} |"
    )


def _shape(default: Any, declaration: Declaration) -> str:
    if declaration.powers:
        return "no powers"
    values = np.asarray(default, dtype=np.float64)
    if values.ndim == 0:
        return f"{default:g}"
    if values.any():
        return f"({', '.join(f'{value:g}' for value in values)})"
    return "triple of 0" if values.ndim == 1 else "matrix of 0"


def write(docs: Path) -> None:
    """The document and its pictures; pictures of effects that are no more go."""
    (docs / "effects.md").write_text(document(), encoding="utf-8")
    folder, drawn = docs / "effects", pictures()
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.svg"):
        if old.name not in drawn:
            old.unlink()
    for name, text in drawn.items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(__file__).resolve().parents[2] / "docs")
