# pyright: strict
"""report.json: its form, read and written with what is wrong said at its place. See docs/gap.md.

Keys that this version does not know are kept: a report of a later version of the same form can be read.
"""

import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gap_diagnosis.report import REPORT_FORMAT, Verdict
from protocol.errors import Fault, TestloomError
from protocol.frozen_model import first_problem

MAX_REPORT_BYTES = 20_000_000
NAMES_A_SET: tuple[Verdict, ...] = ("attributed", "confusable")
"""Verdicts that a set of effects is named by."""
ROUNDING = 1e-6

Probability = Annotated[float, Field(ge=0.0, le=1.0 + ROUNDING)]
NotNegative = Annotated[float, Field(ge=0.0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow", strict=True, allow_inf_nan=False)


class Regime(_Part):
    """A range of one variable."""

    variable: str
    low: float
    high: float
    unit: str


class GapPlace(_Part):
    """A channel in a regime that the baseline does not describe. No regime: everywhere.

    `fitted_tail`: `p_adjusted` lies below what the simulated nulls reach; a tail was fitted to them.
    """

    channel: str
    kind: Literal["deterministic", "stochastic", "timing"]
    regime: Regime | None = None
    p_adjusted: Probability
    excess_rms: NotNegative
    unit: str
    fitted_tail: bool = False


class HeldValue(_Part):
    """A parameter that gives an effect its shape: a time constant, a width, a harmonic."""

    value: float
    unit: str


class FittedValue(HeldValue):
    """A parameter with its standard uncertainty; None: not known."""

    standard_uncertainty: NotNegative | None = None


class Attribution(_Part):
    """One effect with what was found of it.

    Attributes:
        effect: name in the catalogue.
        probability: that it acts, over all sets.
        channels: those that it was found on.
        parameters: free ones, by the effect's own names.
        confusable_with: effects that this excitation cannot tell from it.
        sensor: triad that it acts on; None: the only one that this effect can act on.
        axis: the stand's axis that it follows; None: none.
        held: the parameters that give its shape.
    """

    effect: str
    probability: Probability
    channels: tuple[str, ...] = ()
    parameters: Mapping[str, FittedValue] = Field(default_factory=dict[str, FittedValue])
    confusable_with: tuple[str, ...] = ()
    sensor: str | None = None
    axis: str | None = None
    held: Mapping[str, HeldValue] = Field(default_factory=dict[str, HeldValue])


class EffectSet(_Part):
    """Effects that act together; none: no effect."""

    effects: tuple[str, ...]
    probability: Probability


class ChannelShrinkage(_Part):
    """Residual's root mean square of one channel."""

    before: NotNegative
    after: NotNegative
    unit: str
    noise_floor: NotNegative | None = None


class Shrinkage(_Part):
    """How far the gap closes on data that the fit did not see. See docs/gap.md."""

    held_out: tuple[str, ...] = ()
    before: NotNegative
    after: NotNegative
    noise_floor: NotNegative | None = None
    unit: str
    fraction_closed: float | None = None
    ci95: tuple[float, float] | None = None
    channels: Mapping[str, ChannelShrinkage] = Field(default_factory=dict[str, ChannelShrinkage])


class Remainder(_Part):
    """Whether the best set leaves something: p under the null; what it looks like, in English."""

    p: Probability | None = None
    description: str | None = None


class RankedTest(_Part):
    """A profile as a next test."""

    profile: str
    values: Mapping[str, float] = Field(default_factory=dict[str, float])
    minutes: NotNegative
    expected_bits: NotNegative


class NextTestEntry(RankedTest):
    """The profile to run next. `separates`: names of what it tells apart. `ranked`: all, the best first."""

    separates: tuple[str, ...] = ()
    ranked: tuple[RankedTest, ...] = ()


class UsedRecording(_Part):
    """A recording that the report was made from. `sha256`: as in calibration records."""

    recording_id: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    serial: str = ""
    profile: str = ""


class ReportDocument(_Part):
    """The whole report."""

    format: str
    verdict: Verdict
    where: tuple[GapPlace, ...] = ()
    which: tuple[Attribution, ...] = ()
    sets: tuple[EffectSet, ...] = ()
    class_probability: Probability | None = None
    shrinkage: Shrinkage | None = None
    unattributed: Remainder = Remainder()
    next_test: NextTestEntry | None = None
    product: str = ""
    recordings: tuple[UsedRecording, ...] = ()
    not_used: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _holds_together(self) -> "ReportDocument":
        for name, entries in (("which", self.which), ("sets", self.sets)):
            chances = [entry.probability for entry in entries]
            if any(later > earlier + ROUNDING for earlier, later in itertools.pairwise(chances)):
                raise ValueError(f"{name} is not sorted by probability")
        if self.verdict in NAMES_A_SET:
            if not self.sets or not self.sets[0].effects:
                raise ValueError(f"the verdict '{self.verdict}' needs a first set with effects")
            described = {entry.effect for entry in self.which}
            missing = [name for name in self.sets[0].effects if name not in described]
            if missing:
                raise ValueError(f"which does not describe {', '.join(missing)}")
        return self

    def entries_of(self, effects: tuple[str, ...]) -> tuple[Attribution, ...]:
        """What is said of these effects; one on several triads has several entries."""
        return tuple(entry for entry in self.which if entry.effect in effects)


def read_report(path: Path) -> ReportDocument:
    """The report in a file, or the report.json of a folder.

    Raises:
        TestloomError: no file, no JSON, another format, or a key that is missing or wrong; says where.
    """
    if path.is_dir():
        path = path / "report.json"
    if not path.is_file():
        raise refused("There is no such gap report.", str(path), "name the report.json of a diagnosis.")
    if path.stat().st_size > MAX_REPORT_BYTES:
        raise refused(f"The file is larger than {MAX_REPORT_BYTES} bytes.", str(path), _IS_IT)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise refused("The file is not UTF-8 text.", str(path), _IS_IT) from error
    except OSError as error:
        raise refused(f"The file cannot be read: {error.strerror}.", str(path), "may you read it?") from error
    return parse_report(text, str(path))


def parse_report(text: str, where: str = "report") -> ReportDocument:
    """The report in a text; `where` goes into errors. Raises as `read_report`."""
    try:
        found: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refused(f"The report is not JSON: {error}.", where, _AGAIN) from error
    named = found.get("format") if isinstance(found, dict) else None  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    if named != REPORT_FORMAT:
        raise refused(f"The format is '{named}'.", f"{where}, format", f"this version reads {REPORT_FORMAT}.")
    try:
        return ReportDocument.model_validate_json(text)
    except ValidationError as error:
        raise refused(f"The report is damaged {first_problem(error)}.", where, _AGAIN) from error


def report_text(document: Mapping[str, Any]) -> str:
    """report.json as it is written, checked first. The same document gives the same bytes.

    Raises:
        TestloomError: the document is not of the form: a fault of ours.
    """
    try:
        text = json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        ReportDocument.model_validate_json(text)
    except (TypeError, ValueError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else str(error)
        raise TestloomError(
            f"The diagnosis made a report that is not of its form: {problem}.",
            where="report.json",
            remedy="send us this error.",
        ) from error
    return text


_IS_IT = "is it a gap report?"
_AGAIN = "write it again with 'testloom gap diagnose', or correct it at this place."


def refused(what: str, where: str, remedy: str) -> TestloomError:
    """An error in a report."""
    return TestloomError(what, where=where, fault=Fault.DATA, remedy=remedy)
