# pyright: strict
"""A report in words, in the chosen language: effects, channels and regimes by name, verdicts as sentences."""

from collections.abc import Iterable

from gap_diagnosis.field_units import field_quantity, unit_sign
from gap_diagnosis.report_document import Attribution, EffectSet, GapPlace, ReportDocument, Shrinkage
from protocol.language import say, translated

ORIGINS = {
    "gyro": "gyro",
    "acc": "accelerometer",
    "mag": "magnetometer",
    "gnss": "GNSS receiver",
    "link": "link",
    "stand": "test stand",
    "temperature": "temperature sensor",
}
EFFECTS = {
    "misalignment": "misaligned axes",
    "scale_factor_error": "scale factor error",
    "bias": "bias",
    "bias_temperature": "bias changes with temperature",
    "scale_factor_temperature": "scale factor changes with temperature",
    "misalignment_temperature": "axes turn with temperature",
    "temperature_rate": "bias follows the rate of temperature",
    "thermal_hysteresis": "thermal hysteresis",
    "warm_up": "warm-up",
    "scale_factor_asymmetry": "scale factor asymmetry",
    "scale_factor_nonlinearity": "cubic non-linearity",
    "even_nonlinearity": "even non-linearity",
    "quadratic_nonlinearity": "quadratic non-linearity",
    "odd_quadratic_nonlinearity": "odd quadratic non-linearity",
    "cubic_nonlinearity": "cubic non-linearity",
    "dead_band": "dead band",
    "rate_hysteresis": "rate hysteresis",
    "g_sensitivity": "g-sensitivity",
    "g2_sensitivity": "g²-sensitivity (vibration rectification)",
    "supply_sensitivity": "supply sensitivity",
    "magnetic_sensitivity": "magnetic sensitivity",
    "cross_axis_sensitivity": "cross-axis sensitivity",
    "vibration_rectification": "vibration rectification",
    "size_effect": "size effect",
    "shock_bias_shift": "bias shift after a shock",
    "bandwidth": "limited bandwidth (lag)",
    "angle_random_walk": "angle random walk",
    "velocity_random_walk": "velocity random walk",
    "white_noise": "white noise",
    "bias_instability": "bias instability",
    "flicker_noise": "flicker noise",
    "rate_random_walk": "rate random walk",
    "saturation": "saturation",
    "quantization": "quantization",
    "hard_iron": "hard iron",
    "soft_iron": "soft iron",
    "current_coupling": "field of supply currents",
    "mains_interference": "mains interference",
    "latency": "latency",
    "clock_step": "clock step",
    "antenna_lever_arm": "antenna lever arm",
    "multipath": "multipath",
    "fixed_delay": "fixed delay",
    "clock_drift": "clock drift",
    "timestamp_jitter": "time-stamp jitter",
    "frame_loss": "lost frames",
    "duplicate_frames": "doubled frames",
    "counter_wrap": "number overflow",
    "aliasing": "a tone, perhaps folded down (aliasing)",
    "wobble": "axis wobble",
    "rate_ripple": "rate ripple",
    "encoder_eccentricity": "encoder eccentricity",
    "remount_misalignment": "misalignment after re-mounting",
    "earth_rate": "Earth rate left out",
    "lever_arm": "lever arm",
    "motor_field": "field of the motors",
    "chamber_gradient": "temperature gradient in the chamber",
    "chamber_lag": "unit lags behind the chamber",
    "level_drift": "level drift",
    "non_orthogonality": "axes not square",
    "rate_scale_factor": "rate scale factor",
    "crank_geometry": "crank geometry",
}
"""Word of the catalogue → what a test engineer calls it."""
CLASS_ROUNDING = 1e-3
CLOSED_SHARE = 0.8
"""From here on what is left is something else."""
KINDS = {
    "deterministic": "follows the motion or the conditions",
    "stochastic": "noise",
    "timing": "time-stamps",
}
VARIABLES = {
    "temperature": "temperature",
    "rate": "rate",
    "acceleration": "specific force",
    "specific_force": "specific force",
    "direction": "direction",
    "frequency": "frequency",
    "time_since_power_on": "time since power-on",
    "time": "time",
    "averaging_time": "averaging time",
    "field": "magnetic field",
    "supply": "supply",
    "table_angle": "stand angle",
}


def effect_words(name: str) -> str:
    """'gyro: g-sensitivity' for 'gyro.g_sensitivity'; a name of a later catalogue as it is."""
    origin, _, word = name.partition(".")
    if origin not in ORIGINS or word not in EFFECTS:
        return name
    return say("{origin}: {effect}", origin=say(ORIGINS[origin]), effect=say(EFFECTS[word]))


def set_words(effects: tuple[str, ...]) -> str:
    """Effects that act together; 'no effect' for none."""
    return " + ".join(effect_words(name) for name in effects) if effects else say("no effect")


def channel_words(channel: str) -> str:
    """'gyro x' for 'gyro_x'."""
    sensor, _, axis = channel.partition("_")
    axis = say("norm") if axis == "norm" else axis
    return f"{say(ORIGINS[sensor])} {axis}".strip() if sensor in ORIGINS else channel


def channels_words(channels: Iterable[str]) -> str:
    """'gyro x, y; accelerometer z'."""
    axes: dict[str, list[str]] = {}
    for channel in dict.fromkeys(channels):
        sensor, _, axis = channel.partition("_")
        axes.setdefault(sensor, []).append(say("norm") if axis == "norm" else axis)
    words = (f"{channel_words(sensor)} {', '.join(found)}".strip() for sensor, found in axes.items())
    return "; ".join(words)


def variable_words(variable: str) -> str:
    """'rate x' for 'rate_x'; a variable that is none of ours as it is named."""
    for known, words in VARIABLES.items():
        if variable == known:
            return say(words)
        if variable.startswith(f"{known}_") and variable not in VARIABLES:
            return f"{say(words)} {variable.removeprefix(f'{known}_')}"
    return variable.replace("_", " ")


def regime_words(place: GapPlace) -> str:
    """'temperature 40 … 50 °C'."""
    regime = place.regime
    if regime is None:
        return say("everywhere")
    span = span_words(regime.low, regime.high)
    return f"{variable_words(regime.variable)} {span} {unit_sign(regime.unit)}".strip()


def span_words(low: float, high: float) -> str:
    """'−300 … −100'."""
    return f"{low:.3g} … {high:.3g}".replace("-", "−")


def parameter_lines(entry: Attribution) -> tuple[str, ...]:
    """Each parameter with its uncertainty in the field's units, then what gives the effect its shape."""
    fitted = (
        f"{name} = {field_quantity(one.value, one.unit, one.standard_uncertainty)}"
        for name, one in entry.parameters.items()
    )
    held = (f"{name} = {field_quantity(one.value, one.unit)}" for name, one in entry.held.items())
    axis = (say("axis of the stand: {axis}", axis=entry.axis),) if entry.axis else ()
    return (*fitted, *held, *axis)


def verdict_words(report: ReportDocument) -> str:
    """The verdict in a word or two."""
    return verdict_name(report.verdict)


def verdict_name(verdict: str) -> str:
    """The same, of a verdict's name."""
    return say(
        {
            "no_gap": "No gap",
            "attributed": "Cause found",
            "confusable": "Cause narrowed down",
            "unattributed": "Gap without a known cause",
        }[verdict]
    )


def verdict_sentences(report: ReportDocument) -> tuple[str, ...]:
    """What it comes to, for a test engineer."""
    match report.verdict:
        case "no_gap":
            return (
                say("Simulator and recordings agree: what is left is the noise that the simulator expects."),
            )
        case "attributed":
            return (
                say(
                    "The recordings differ from the simulator, and one cause explains it: {cause}.",
                    cause=_on_channels(report, report.sets[0].effects),
                ),
                say("Its probability is {chance}.", chance=percent(report.sets[0].probability)),
                *_closed(report.shrinkage),
            )
        case "confusable":
            return (
                _confusable(report),
                *_class_chance(report),
                *_closed(report.shrinkage),
            )
        case "unattributed":
            what = report.unattributed.description
            return (
                say("The recordings differ from the simulator, and no known effect explains it."),
                *((translated(what),) if what else ()),
                *_left_over(report),
            )


def _confusable(report: ReportDocument) -> str:
    """Several sets that cannot be told apart; or one, with an effect in it that looks like another."""
    members = class_members(report)
    alike = next((one for one in report.which if one.confusable_with), None)
    if len(members) == 1 and alike is not None:
        return say(
            "The recordings differ from the simulator, and this explains it: {cause}. But this test cannot "
            "tell {one} from {other}.",
            cause=_on_channels(report, members[0].effects),
            one=effect_words(alike.effect),
            other=_joined([effect_words(name) for name in alike.confusable_with]),
        )
    return say(
        "The recordings differ from the simulator, and one of these explains it, but this "
        "test cannot tell which: {causes}.",
        causes=_joined([set_words(one.effects) for one in members]),
    )


def class_members(report: ReportDocument) -> tuple[EffectSet, ...]:
    """The most probable sets that together have the class's probability; at least two where there are."""
    wanted, total = (report.class_probability or 1.0) - CLASS_ROUNDING, 0.0
    members: list[EffectSet] = []
    for one in report.sets:
        if not one.effects:
            continue
        members.append(one)
        total += one.probability
        if total >= wanted and len(members) > 1:
            break
    return tuple(members)


def percent(share: float) -> str:
    """'99.6 %'; '> 99.9 %' rather than 100 % of what is not certain."""
    if share >= 0.9995:
        return "> 99.9 %"
    if 0.0 < share < 0.0005:
        return "< 0.1 %"
    return f"{100 * share:.1f} %".replace("-", "−")


def closed_words(shrinkage: Shrinkage) -> str:
    """The share of the gap that closes, with its 95 % interval."""
    if shrinkage.fraction_closed is None:
        return "–"
    share = percent(shrinkage.fraction_closed)
    if shrinkage.ci95 is None:
        return share
    low, high = (percent(limit) for limit in shrinkage.ci95)
    return say("{share} (95 %: {low} to {high})", share=share, low=low, high=high)


def _closed(shrinkage: Shrinkage | None) -> tuple[str, ...]:
    if shrinkage is None or shrinkage.fraction_closed is None:
        return ()
    return (
        say(
            "With it in the simulator, {share} of the gap closes on data that the fit did not see.",
            share=closed_words(shrinkage),
        ),
    )


def _left_over(report: ReportDocument) -> tuple[str, ...]:
    closed = report.shrinkage.fraction_closed if report.shrinkage else None
    if closed is None or closed <= 0.0:
        return ()
    if closed >= CLOSED_SHARE and report.sets and report.sets[0].effects:
        return (
            say(
                "Known effects are there too: {cause} closes {share} of what it can explain; the rest "
                "is beside it.",
                cause=set_words(report.sets[0].effects),
                share=percent(closed),
            ),
        )
    return (
        say(
            "The best combination of known effects closes {share} of it, which is not enough to be named.",
            share=percent(closed),
        ),
    )


def _class_chance(report: ReportDocument) -> tuple[str, ...]:
    if report.class_probability is None:
        return ()
    return (
        say(
            "That it is one of them has a probability of {chance}.", chance=percent(report.class_probability)
        ),
    )


def _on_channels(report: ReportDocument, effects: tuple[str, ...]) -> str:
    parts: list[str] = []
    for name in effects:
        on = channels_words(c for entry in report.entries_of((name,)) for c in entry.channels)
        words = effect_words(name)
        parts.append(say("{effect} (on {channels})", effect=words, channels=on) if on else words)
    return " + ".join(parts)


def _joined(words: list[str]) -> str:
    if len(words) < 2:
        return "".join(words)
    return say("{first} or {last}", first=", ".join(words[:-1]), last=words[-1])
