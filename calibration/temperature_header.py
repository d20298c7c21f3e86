"""A temperature model as a C header for the unit's firmware: constants and the function that uses them.

Single precision, no library, no division by a table entry. Units are the model's (SI). The same text
for the same model, always; nothing of time or place is in it.
"""

# pyright: strict
import re
from collections.abc import Iterable

from calibration.algorithms.temperature_compensation import NODE_MARGIN_C, TemperatureModel
from calibration.records.record import LINEAR_TRIAD_TEMPERATURE, CalibrationRecord
from calibration.records.temperature_contents import model_of_record
from protocol.errors import CalibrationError, Fault

IDENTIFIER = re.compile(r"[a-z][a-z0-9_]{0,31}")

_FUNCTION = """\
/* E = K (N - sigma(N, T) - D); returns 1 within the calibrated range. Beyond it the end node's
   coefficients hold, and how wrong they are is not known: returns 0. */
static inline int {name}_compensate(const float n[3], float temperature_c, float e[3])
{{
    const float place = (temperature_c - {name}_first_node_c) / {name}_node_step_c;
    float clipped = place > 0.0f ? place : 0.0f;
    int node, i, within;
    float along, r[3];
    clipped = clipped < (float)({upper}_NODES - 1) ? clipped : (float)({upper}_NODES - 1);
    node = (int)clipped;
    node = node < {upper}_NODES - 1 ? node : {upper}_NODES - 2;
    along = clipped - (float)node;
    for (i = 0; i < 3; ++i) {{
        const float *low = {name}_sigma[node][i], *high = {name}_sigma[node + 1][i];
        const float a = low[0] + along * (high[0] - low[0]);
        const float b = low[1] + along * (high[1] - low[1]);
        const float c = low[2] + along * (high[2] - low[2]);
        r[i] = n[i] - ((a * n[i] + b) * n[i] + c) - {name}_bias[i];
    }}
    for (i = 0; i < 3; ++i)
        e[i] = {name}_compensation[i][0] * r[0] + {name}_compensation[i][1] * r[1]
             + {name}_compensation[i][2] * r[2];
    within = place >= -{name}_node_margin && place <= (float)({upper}_NODES - 1) + {name}_node_margin;
    return within;
}}
"""


def header_of_record(record: CalibrationRecord, name: str) -> str:
    """The header of a record of method `temperature_compensation`.

    Raises:
        CalibrationError: a record of another method, a table that is not whole, or as `firmware_header`.
    """
    if record.model.name != LINEAR_TRIAD_TEMPERATURE:
        raise CalibrationError(
            f"A record of the method '{record.method}' holds no temperature table.",
            where=f"record {record.title}",
            fault=Fault.OPERATOR,
            remedy="take a record of the method temperature_compensation.",
        )
    origin = f"Unit {record.serial}, {record.sensor}, record {record.sha256()[:12]}."
    return firmware_header(model_of_record(record), name, origin)


def firmware_header(model: TemperatureModel, name: str, origin: str) -> str:
    """The header's text.

    Args:
        model: with two nodes or more.
        name: C identifier in small letters that all names begin with, such as 'acc'.
        origin: one line that tells the unit and the record, for a comment.

    Raises:
        CalibrationError: a name that is none in C, an origin that would end the comment, or one node.
    """
    if not IDENTIFIER.fullmatch(name) or "*/" in origin or not origin.isprintable():
        raise _refused(f"'{name}' is no C name in small letters, or '{origin}' is no line of a comment.")
    if len(model.node_c) < 2:
        raise _refused("A table takes two nodes or more.")
    step = float(model.node_c[1] - model.node_c[0])
    upper = name.upper()
    low, high = model.calibrated_range_c
    nodes = ",\n".join(
        f"    {{{', '.join(_braced(axis) for axis in node)}}} /* {place:g} deg C */"
        for place, node in zip(model.node_c.tolist(), model.coefficients.tolist(), strict=True)
    )
    lines = [
        f"/* Temperature compensation. {origin}",
        f"   Unit: {model.room.unit}. Calibrated from {low:g} to {high:g} deg C. */",
        f"#ifndef {upper}_TEMPERATURE_H",
        f"#define {upper}_TEMPERATURE_H",
        "",
        f"#define {upper}_NODES {len(model.node_c)}",
        f"static const float {name}_first_node_c = {_number(low)};",
        f"static const float {name}_node_step_c = {_number(step)};",
        f"static const float {name}_node_margin = {_number(NODE_MARGIN_C / step)}; /* of a step */",
        f"/* K = inv(M) and D, {model.room.unit}, frozen at room temperature. */",
        f"static const float {name}_compensation[3][3] = "
        f"{{{', '.join(_braced(row) for row in model.room.compensation.tolist())}}};",
        f"static const float {name}_bias[3] = {_braced(model.room.bias.tolist())};",
        "/* sigma = a N^2 + b N + c: {a, b, c} of x, y, z at each node. */",
        f"static const float {name}_sigma[{upper}_NODES][3][3] = {{",
        nodes,
        "};",
        "",
        _FUNCTION.format(name=name, upper=upper),
        f"#endif /* {upper}_TEMPERATURE_H */",
        "",
    ]
    return "\n".join(lines)


def _braced(values: Iterable[float]) -> str:
    return "{" + ", ".join(_number(value) for value in values) + "}"


def _number(value: float) -> str:
    """Nine digits: enough that every single-precision number comes back."""
    return f"{value:.8e}f"


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what, where="header of a temperature table", fault=Fault.OPERATOR, remedy="choose another name."
    )
